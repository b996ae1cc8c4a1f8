#include "mapperd/map/snapshot.hpp"

#include <algorithm>

namespace mapperd::map {
namespace {

DenseBlocks written_out(const VoxelMap& map, const Block* const* blocks, std::size_t count) {
  DenseBlocks dense;
  DenseVoxels voxels;
  dense.keys.reserve(count);
  dense.units.reserve(count * kBlockVoxels);
  dense.counts.reserve(count * kBlockVoxels);
  for (std::size_t b = 0; b < count; ++b) {
    dense.keys.push_back(blocks[b]->key);
    blocks[b]->copy_voxels(map.rule(), map.pool(), voxels);
    for (const std::int16_t units : voxels.units)
      dense.units.push_back(map.rule().file_units(units));
    dense.counts.insert(dense.counts.end(), voxels.count.begin(), voxels.count.end());
  }
  return dense;
}

}  // namespace

MapSize size_of(const VoxelMap& map) {
  const ReadLock lock(map);
  return {map.block_count(), map.known_count(), map.held_count(), map.memory_bytes(),
          map.revision()};
}

std::size_t memory_bytes(const VoxelMap& map) {
  const ReadLock lock(map);
  return map.memory_bytes();
}

ClassCounts count_classes(const VoxelMap& map, const Thresholds& thresholds) {
  check_thresholds(thresholds);
  const ReadLock lock(map);
  ClassCounts counts;
  map.for_each_known([&](const VoxelIndex&, const VoxelState& state) {
    switch (thresholds.of(state)) {
      case Occupancy::kOccupied:
        ++counts.occupied;
        break;
      case Occupancy::kFree:
        ++counts.free;
        break;
      case Occupancy::kUnknown:
        ++counts.uncertain;
        break;
    }
  });
  return counts;
}

std::vector<VoxelState> states_at(const VoxelMap& map, const Points& points) {
  std::vector<VoxelState> states(points.count);
  const ReadLock lock(map);
  for (std::size_t i = 0; i < points.count; ++i) states[i] = map.at(points[i]);
  return states;
}

std::vector<KnownVoxel> voxels_between(const VoxelMap& map, double low_log_odds,
                                       double high_log_odds) {
  std::vector<KnownVoxel> found;
  const ReadLock lock(map);
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    if (state.log_odds > low_log_odds && state.log_odds < high_log_odds) {
      found.push_back({voxel, state});
    }
  });
  return found;
}

DenseBlocks dense_blocks(const VoxelMap& map, std::size_t begin, std::size_t count) {
  const ReadLock lock(map);
  const std::vector<const Block*> sorted = map.sorted_blocks();
  begin = std::min(begin, sorted.size());
  return written_out(map, sorted.data() + begin, std::min(count, sorted.size() - begin));
}

void for_dense_blocks(const VoxelMap& map, std::size_t at_once,
                      const std::function<void(const DenseBlocks&)>& visit) {
  const ReadLock lock(map);
  const std::vector<const Block*> sorted = map.sorted_blocks();
  for (std::size_t begin = 0; begin < sorted.size(); begin += at_once) {
    visit(written_out(map, sorted.data() + begin, std::min(at_once, sorted.size() - begin)));
  }
}

}  // namespace mapperd::map
