// The map as the map stream tells it: blocks of 8 x 8 x 8 cells, a cell a cube of 2^level voxels
// along an edge, each cell one byte. Stream block (x, y, z) begins at 8 * 2^level * (x, y, z)
// voxels; none reaches beyond one brick, so that each lies in one tile.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

inline constexpr int kStreamEdge = 8;
inline constexpr int kStreamCells = kStreamEdge * kStreamEdge * kStreamEdge;
inline constexpr int kMaxStreamLevel = 3;
inline constexpr std::int8_t kStreamUnknown = -128;

enum class StreamDetail { kClasses, kLogOdds, kCounts };

// How cells are told: -128 unknown; else, of the highest log-odds of the cell's known voxels, the
// class, or the log-odds in whole steps (halves to even) within +-127, and on the same side of both
// thresholds: whoever is told of steps must find the classes that the map has.
struct StreamView {
  int level = 0;
  StreamDetail detail = StreamDetail::kLogOdds;
  double log_odds_step = 0.25;
  Thresholds thresholds;
};

struct ChangedBlocks {
  std::uint64_t revision = 0;  // of the map
  std::uint64_t replaced_at = 0;
  std::vector<BlockKey> keys;            // of the map's blocks, in no particular order
  std::vector<std::uint64_t> revisions;  // of each
  std::vector<std::uint8_t> resident;    // 1 for each brick asked about that is in memory
};

// The map's resident blocks that changed after a revision, and which of some bricks are in memory,
// both of one state.
ChangedBlocks changed_blocks(const VoxelMap& map, std::uint64_t revision,
                             const std::vector<BlockKey>& bricks);

struct StreamDigests {
  std::vector<std::uint64_t> digests;    // of cells, and of counts if they are told; 0: all unknown
  std::vector<std::uint64_t> revisions;  // of the map, when a voxel of the block last changed
  std::vector<std::uint8_t> resident;
};

// Of stream blocks; what is not resident reads as unknown.
// Throws std::invalid_argument for a view that there is not.
StreamDigests stream_digests(const VoxelMap& map, const StreamView& view,
                             const std::vector<BlockKey>& keys);

struct StreamBlocks {
  std::uint64_t revision = 0;            // of the map
  std::vector<std::int8_t> cells;        // kStreamCells a block, x fastest
  std::vector<std::uint8_t> count_bits;  // bit length of the highest count of a cell's voxels
  std::vector<std::uint8_t> resident;
};

// Throws std::invalid_argument for a view that there is not.
StreamBlocks stream_blocks(const VoxelMap& map, const StreamView& view,
                           const std::vector<BlockKey>& keys);

}  // namespace mapperd::map
