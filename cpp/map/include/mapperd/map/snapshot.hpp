/// \file
/// \brief The map's content as plain values and arrays, each taken from one state of the map.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Size of a map.
struct MapSize {
  std::size_t blocks = 0;
  std::size_t known_voxels = 0;
  std::size_t held_voxels = 0;  ///< one by one
  std::size_t memory_bytes = 0;
  std::uint64_t revision = 0;
};

MapSize size_of(const VoxelMap& map);

/// Bytes allocated, without counting voxels: constant time.
std::size_t memory_bytes(const VoxelMap& map);

/// Observed voxels by class.
struct ClassCounts {
  std::size_t occupied = 0;
  std::size_t free = 0;
  std::size_t uncertain = 0;
};

/// \throws std::invalid_argument for thresholds out of order.
ClassCounts count_classes(const VoxelMap& map, const Thresholds& thresholds);

/// Returns one state per point of the map frame, m; unknown beyond the map's reach and for points
/// that are not finite.
std::vector<VoxelState> states_at(const VoxelMap& map, const Points& points);

/// Observed voxels with low < L < high, in the map's canonical order.
std::vector<KnownVoxel> voxels_between(const VoxelMap& map, double low_log_odds,
                                       double high_log_odds);

/// Blocks as dense arrays, x fastest: kBlockVoxels units and counts per key.
struct DenseBlocks {
  std::vector<BlockKey> keys;
  std::vector<std::int32_t> units;  ///< of kLogOddsUnit
  std::vector<std::uint16_t> counts;
};

/// `count` blocks from the one with index `begin` of the canonical order on, or as many as there
/// are.
DenseBlocks dense_blocks(const VoxelMap& map, std::size_t begin, std::size_t count);

/// Visits all blocks in canonical order, `at_once` at a time: dense blocks are larger than the map.
/// All are of one state of the map: it is read-locked until the visit ends, and the visitor must
/// not access the map.
void for_dense_blocks(const VoxelMap& map, std::size_t at_once,
                      const std::function<void(const DenseBlocks&)>& visit);

}  // namespace mapperd::map
