#include "mapperd/map/merge.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <optional>
#include <stdexcept>

namespace mapperd::map {
namespace {

void check_equal_kind(const VoxelMap& map, const VoxelMap& other) {
  if (&map == &other) throw std::invalid_argument("a map cannot be merged into itself");
  if (map.resolution_m() != other.resolution_m()) {
    throw std::invalid_argument("maps of different resolutions cannot be merged");
  }
  const IwloParams& a = map.rule().params();
  const IwloParams& b = other.rule().params();
  if (a.prior != b.prior) throw std::invalid_argument("maps of different priors cannot be merged");
  if (a.L_min != b.L_min || a.L_max != b.L_max) {
    throw std::invalid_argument("maps with different clamps (L_min, L_max) cannot be merged");
  }
  if (map.rule().settled_count() != other.rule().settled_count()) {
    throw std::invalid_argument(
        "maps that count differently (decay_rate, min_alpha) cannot be merged");
  }
}

// Locks all maps of a merge in the order of their addresses: two merges that name the same maps in
// other roles wait for each other, but not both at once.
class MergeLocks {
 public:
  MergeLocks(VoxelMap& map, std::vector<const VoxelMap*> maps) {
    maps.push_back(&map);
    std::sort(maps.begin(), maps.end(), std::less<>());
    maps.erase(std::unique(maps.begin(), maps.end()), maps.end());  // one may be named twice
    for (const VoxelMap* each : maps) {
      if (each == &map) {
        written_.emplace(map);
      } else {
        read_.emplace_back(*each);
      }
    }
  }

 private:
  std::optional<WriteLock> written_;
  std::vector<ReadLock> read_;
};

std::vector<BlockKey> keys_of(const std::vector<const VoxelMap*>& maps) {
  std::vector<BlockKey> keys;
  for (const VoxelMap* map : maps) {
    for (const Block* block : map->sorted_blocks()) keys.push_back(block->key);
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  return keys;
}

// What all maps but one know of one block.
struct Sum {
  std::vector<std::int64_t> units;  // of files: maps may hold others
  std::vector<std::uint64_t> count;

  Sum(const std::vector<const VoxelMap*>& maps, const BlockKey& key)
      : units(kBlockVoxels), count(kBlockVoxels) {
    DenseVoxels voxels;
    for (const VoxelMap* map : maps) {
      const Block* block = map->find(key);
      if (block == nullptr) continue;
      block->copy_voxels(map->rule(), map->pool(), voxels);
      for (std::size_t i = 0; i < kBlockVoxels; ++i) {
        units[i] += map->rule().file_units(voxels.units[i]);
        count[i] += voxels.count[i];
      }
    }
  }

  bool is_nothing() const {
    return std::all_of(count.begin(), count.end(), [](std::uint64_t n) { return n == 0; });
  }
};

void add_to(VoxelMap& map, const BlockKey& key, const Sum& sum) {
  if (sum.is_nothing()) return;
  const IwloRule& rule = map.rule();
  DenseVoxels voxels;
  map.get_or_create(key).copy_voxels(rule, map.pool(), voxels);
  std::array<Voxel, kBlockVoxels> states;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    const std::int64_t total = rule.file_units(voxels.units[i]) + sum.units[i];
    const std::uint64_t count = voxels.count[i] + sum.count[i];
    const double log_odds = std::ldexp(static_cast<double>(total), -24) + rule.params().prior;
    states[i] = {rule.units(log_odds),
                 static_cast<std::uint16_t>(std::min<std::uint64_t>(count, rule.settled_count()))};
  }
  map.set_block(key, states);
}

}  // namespace

void merge(VoxelMap& map, const std::vector<const VoxelMap*>& others) {
  for (const VoxelMap* other : others) check_equal_kind(map, *other);
  const MergeLocks locks(map, others);
  for (const BlockKey& key : keys_of(others)) add_to(map, key, Sum(others, key));
}

VoxelMap with_rule(const VoxelMap& map, const IwloParams& params) {
  VoxelMap copy(map.resolution_m(), params);
  const ReadLock lock(map);
  for (const Block* block : map.sorted_blocks()) add_to(copy, block->key, Sum({&map}, block->key));
  return copy;
}

}  // namespace mapperd::map
