// The memory that a map takes: little, and as much as it says.
#include <memory>

#include "allocations.hpp"
#include "check.hpp"
#include "mapperd/map/voxel_map.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::Block;
using mapperd::map::IwloParams;
using mapperd::map::VoxelMap;

// A line of blocks: of the first `dense` every voxel differs from its neighbours, the rest is free
// water.
void fill(VoxelMap& map, int dense, int uniform) {
  const mapperd::map::IwloRule& rule = map.rule();
  for (int b = 0; b < dense + uniform; ++b) {
    Block& block = map.get_or_create({b % 100, b / 100, -1});
    if (b < dense) {
      auto& voxels = block.open(rule);
      for (std::size_t i = 0; i < mapperd::map::kBlockVoxels; ++i) {
        rule.add(0.001 * static_cast<double>(i % 7), voxels.units[i], voxels.count[i]);
      }
      block.close(rule);
    }
    block.add_free_everywhere(rule);
  }
}

double per_voxel(const VoxelMap& map) {
  return static_cast<double>(map.memory_bytes()) /
         static_cast<double>(map.block_count() * mapperd::map::kBlockVoxels);
}

TEST_CASE("a voxel takes at most 8 bytes where surfaces are, from the first block on") {
  for (const int blocks : {1, 2, 33, 65, 500, 4097}) {
    VoxelMap map(0.1, {});
    fill(map, blocks, 0);
    CHECK(per_voxel(map) <= 8.0);
  }
}

TEST_CASE("uniform space takes hundredths of a byte a voxel") {
  VoxelMap map(0.1, {});
  fill(map, 0, 5000);
  CHECK(map.known_count() == 5000U * mapperd::map::kBlockVoxels);
  CHECK(per_voxel(map) < 0.03);
}

#ifdef MAPPERD_COUNTS_ALLOCATIONS

void check_memory(const IwloParams& params, int dense, int uniform) {
  const std::size_t in_use_before = allocations::in_use();
  const std::size_t allocated_before = allocations::counted();
  const auto map = std::make_unique<VoxelMap>(0.1, params);
  const auto check_now = [&] {
    const auto told = static_cast<double>(map->memory_bytes());
    CHECK_NEAR(told / static_cast<double>(allocations::counted() - allocated_before), 1.0, 0.05);
    if (told > 1e6)
      CHECK_NEAR(told / static_cast<double>(allocations::in_use() - in_use_before), 1.0, 0.05);
  };
  check_now();
  fill(*map, dense, uniform);
  check_now();
  map->clear();
  check_now();
  CHECK(map->memory_bytes() == VoxelMap(0.1, params).memory_bytes());
  fill(*map, uniform % 50, dense);
  check_now();
}

TEST_CASE("the memory reported is the memory that malloc says was taken") {
  IwloParams slow;  // whose tables are larger than a small map
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;
  for (const IwloParams& params : {IwloParams{}, slow}) {
    check_memory(params, 0, 1);
    check_memory(params, 1, 0);
    check_memory(params, 3, 40);
    check_memory(params, 0, 1000);
    check_memory(params, 0, 70000);
    check_memory(params, 700, 3000);
    check_memory(params, 3000, 20000);
  }
}

#endif

}  // namespace
