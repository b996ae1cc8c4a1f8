/// \file
/// \brief The map as the map stream encodes it: blocks of 8 x 8 x 8 cells, a cell a cube of 2^level
/// voxels along an edge, each cell one byte. Stream block (x, y, z) begins at 8 * 2^level * (x, y,
/// z) voxels; none reaches beyond one brick, so that each lies in one tile.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
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

/// Content of a cell: its class, its log-odds, or its log-odds and counts.
enum class StreamDetail { kClasses, kLogOdds, kCounts };

/// Encoding of cells: -128 unknown; else, of the highest log-odds of the cell's known voxels, the
/// class, or the log-odds in whole steps (halves to even) within +-127, and on the same side of
/// both thresholds: a client that receives steps must find the classes of the map.
struct StreamView {
  int level = 0;  ///< cells are cubes of 2^level voxels, 0 to kMaxStreamLevel
  StreamDetail detail = StreamDetail::kLogOdds;
  double log_odds_step = 0.25;
  Thresholds thresholds;
};

/// Result of changed_blocks().
struct ChangedBlocks {
  std::uint64_t revision = 0;            ///< of the map
  std::uint64_t replaced_at = 0;         ///< VoxelMap::replaced_at()
  std::vector<BlockKey> keys;            ///< of the map's blocks, in no particular order
  std::vector<std::uint64_t> revisions;  ///< of each
  std::vector<std::uint8_t> resident;    ///< per requested brick: 1 if it is in memory
};

/// Returns the resident blocks that changed after a revision, and which of some bricks are in
/// memory, both of one state of the map.
ChangedBlocks changed_blocks(const VoxelMap& map, std::uint64_t revision,
                             const std::vector<BlockKey>& bricks);

/// Digests of stream blocks, one entry per key.
struct StreamDigests {
  std::vector<std::uint64_t> digests;    ///< of cells, and of counts if requested; 0: all unknown
  std::vector<std::uint64_t> revisions;  ///< of the map, when a voxel of the block last changed
  std::vector<std::uint8_t> resident;
};

/// Returns the digests of stream blocks; blocks that are not resident read as unknown. /// \throws
/// std::invalid_argument for an invalid view.
StreamDigests stream_digests(const VoxelMap& map, const StreamView& view,
                             const std::vector<BlockKey>& keys);

/// Content of stream blocks, in the order of their keys.
struct StreamBlocks {
  std::uint64_t revision = 0;            ///< of the map
  std::vector<std::int8_t> cells;        ///< kStreamCells a block, x fastest
  std::vector<std::uint8_t> count_bits;  ///< bit length of the highest count of a cell's voxels
  std::vector<std::uint8_t> resident;
};

/// Returns the cells of stream blocks.
/// \throws std::invalid_argument for an invalid view.
StreamBlocks stream_blocks(const VoxelMap& map, const StreamView& view,
                           const std::vector<BlockKey>& keys);

}  // namespace mapperd::map
