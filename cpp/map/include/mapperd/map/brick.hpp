/// \file
/// \brief Bricks of 4 x 4 x 4 blocks: what a map on disk is written and read by. Small enough that
/// a ping changes few of them, large enough that a row of a table costs little beside it.
///
/// A brick as bytes, little endian: number of blocks u8; for each of them, in ascending order, its
/// place in the brick u8 (x fastest), its revision u64 and its voxels (block_codec.hpp). Blocks
/// without an observed voxel are left out.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

inline constexpr int kBrickShift = 2;
inline constexpr int kBrickEdge = 1 << kBrickShift;
inline constexpr int kBrickBlocks = kBrickEdge * kBrickEdge * kBrickEdge;

inline BlockKey brick_holding(const BlockKey& block) {
  return {block.x >> kBrickShift, block.y >> kBrickShift, block.z >> kBrickShift};
}

/// An encoded block, as the store keeps it.
struct Brick {
  BlockKey key;                ///< in bricks
  std::uint64_t revision = 0;  ///< of the block that changed last
  std::string bytes;
};

/// Blocks that changed since a revision, encoded.
struct ChangedBricks {
  std::uint64_t revision = 0;  ///< of the map, when they were taken
  std::vector<Brick> bricks;   ///< in ascending order
};

/// Resident bricks with a block that changed after a revision of the map, all of one state.
ChangedBricks bricks_since(const VoxelMap& map, std::uint64_t revision);

/// An encoded block in memory that another object owns.
struct BrickView {
  BlockKey key;
  std::string_view bytes;
};

/// Sets the content of bricks from their bytes and makes tiles resident, in one step. Blocks keep
/// the revisions that they were written with, and the map's is not below them. Throws
/// std::invalid_argument for anything but bricks that a map of this rule may hold, and
/// std::logic_error where a tile is not resident; the map is then as before.
void put_bricks(VoxelMap& map, const std::vector<BrickView>& bricks,
                const std::vector<BlockKey>& tiles = {});

/// Drops tiles from memory, without writing them.
void drop_tiles(VoxelMap& map, const std::vector<BlockKey>& tiles);

}  // namespace mapperd::map
