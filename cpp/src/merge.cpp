#include "mapperd/merge.hpp"

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "mapperd/block_writer.hpp"

namespace mapperd {
namespace {

void check_equal_kind(const VoxelMap& map, const VoxelMap& other) {
  if (&map == &other) throw std::invalid_argument("a map cannot be merged into itself");
  if (map.resolution_m() != other.resolution_m()) {
    throw std::invalid_argument("maps of different resolutions cannot be merged");
  }
  const IwloParams& a = map.rule().params();
  const IwloParams& b = other.rule().params();
  if (a.L_min != b.L_min || a.L_max != b.L_max) {
    throw std::invalid_argument("maps with different clamps (L_min, L_max) cannot be merged");
  }
  if (map.rule().settled_count() != other.rule().settled_count()) {
    throw std::invalid_argument(
        "maps that count differently (decay_rate, min_alpha) cannot be merged");
  }
}

float clamped(double log_odds, const IwloParams& params) {
  return static_cast<float>(std::clamp(log_odds, params.L_min, params.L_max));
}

}  // namespace

void merge(VoxelMap& map, const std::vector<const VoxelMap*>& others) {
  for (const VoxelMap* other : others) check_equal_kind(map, *other);
  const IwloRule& rule = map.rule();
  BlockWriter writer(map);
  for (std::size_t k = 0; k < others.size(); ++k) {
    others[k]->for_each_known([&](const VoxelIndex& voxel, const VoxelState&) {
      for (std::size_t earlier = 0; earlier < k; ++earlier) {
        if (others[earlier]->at(voxel).count != 0) return;  // already done
      }
      const VoxelState own = writer.at(voxel);
      double log_odds = own.log_odds;
      std::uint64_t count = own.count;
      for (const VoxelMap* other : others) {
        const VoxelState state = other->at(voxel);
        log_odds += static_cast<double>(state.log_odds);
        count += state.count;
      }
      count = std::min<std::uint64_t>(count, rule.settled_count());
      writer.set(voxel, {clamped(log_odds, rule.params()), static_cast<std::uint16_t>(count)});
    });
  }
  writer.flush();
}

VoxelMap with_rule(const VoxelMap& map, const IwloParams& params) {
  VoxelMap copy(map.resolution_m(), params);
  const std::uint16_t settled = copy.rule().settled_count();
  BlockWriter writer(copy);
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    writer.set(voxel, {clamped(state.log_odds, params), std::min(state.count, settled)});
  });
  writer.flush();
  return copy;
}

}  // namespace mapperd
