// The memory that a map takes: little, and as much as it reports.
#include <cstdio>
#include <memory>
#include <vector>

#include "allocations.hpp"
#include "mapperd/map/brick.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/snapshot.hpp"
#include "mapperd/map/voxel_map.hpp"
#include "maps.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::BlockKey;
using mapperd::map::IwloParams;
using mapperd::map::kBlockCells;
using mapperd::map::kBlockVoxels;
using mapperd::map::kCellVoxels;
using mapperd::map::VoxelMap;

BlockKey key_of(int block) { return {block % 100, block / 100, -1}; }

// Blocks in which one cell of so many is held, no voxel of it like its neighbours, and the rest
// seen free; behind them free water.
void fill(VoxelMap& map, int blocks, int one_of, int water) {
  for (int b = 0; b < blocks + water; ++b) {
    maps::see_free(map, key_of(b));
    if (b >= blocks) continue;
    mapperd::map::CellPool::Cache pool(map.pool());
    mapperd::map::Block& block = map.get_or_create(key_of(b));
    for (int cell = b % one_of; cell < kBlockCells; cell += one_of) {
      const mapperd::map::CellVoxels voxels = block.open(map.rule(), pool, cell);
      for (int v = 0; v < kCellVoxels; ++v) voxels.units()[v] = static_cast<std::int16_t>(v);
      block.close(map.rule(), pool, cell);
    }
  }
}

double bytes_of(const VoxelMap& map) { return static_cast<double>(map.memory_bytes()); }

TEST_CASE("a voxel that is held takes four bytes at most, all overhead counted") {
  for (const int blocks : {33, 65, 700, 4097}) {
    for (const int one_of : {1, 3}) {
      VoxelMap map(0.1, {});
      fill(map, blocks, one_of, 0);
      CHECK(map.held_count() >= static_cast<std::size_t>(blocks) * 21 * kCellVoxels);
      const double overhead = bytes_of(VoxelMap(0.1, {}));  // tables of the rule
      const double each = (bytes_of(map) - overhead) / static_cast<double>(map.held_count());
      std::printf("  %d blocks, one cell of %d held: %.3f bytes a held voxel\n", blocks, one_of,
                  each);
      CHECK(each <= 4.0);
      if (blocks >= 700) CHECK(bytes_of(map) / static_cast<double>(map.held_count()) <= 4.0);
    }
  }
}

TEST_CASE("space that is alike cell by cell takes a few bytes a cell") {
  VoxelMap map(0.1, {});
  fill(map, 0, 1, 5000);
  CHECK((map.known_count() == 5000U * kBlockVoxels && map.held_count() == 0));
  const double each = (bytes_of(map) - bytes_of(VoxelMap(0.1, {}))) / (5000.0 * kBlockCells);
  std::printf("  %.2f bytes a cell, %.3f a voxel\n", each, each / kCellVoxels);
  CHECK(each <= 7.5);
}

TEST_CASE("the map of a usual ping takes less than four bytes a held voxel in all") {
  scenes::Random random(5);
  VoxelMap map(0.05, {});
  for (int i = 0; i < 10; ++i) {
    scenes::Ragged want;
    want.thickness = 6;
    want.jump = 0.02;
    want.max_range_m = 10;
    const scenes::Ping ping = scenes::ragged_ping(want, random);
    integrate_evidence_grid(map, ping.image(), scenes::rotation_zyx(0.05 * i, 0.2, 0), {});
  }
  const auto held = static_cast<double>(map.held_count());
  const auto known = static_cast<double>(map.known_count());
  std::printf("  %.2f bytes a held voxel, %.2f a known one\n", bytes_of(map) / held,
              bytes_of(map) / known);
  CHECK((held > 1e5 && bytes_of(map) <= 4.0 * held));
}

#ifdef MAPPERD_COUNTS_ALLOCATIONS

// The memory that a map reports, against malloc.
class Watch {
 public:
  void check(const VoxelMap& map) const {
    const double reported = bytes_of(map);
    CHECK((reported / static_cast<double>(allocations::counted() - counted_)) == near(1.0, 0.05));
    if (reported > 1e6)
      CHECK((reported / static_cast<double>(allocations::in_use() - in_use_)) == near(1.0, 0.05));
  }

 private:
  std::size_t in_use_ = allocations::in_use();
  std::size_t counted_ = allocations::counted();
};

void check_memory(const IwloParams& params, int blocks, int one_of, int water) {
  const Watch watch;
  const auto map = std::make_unique<VoxelMap>(0.1, params);
  watch.check(*map);
  fill(*map, blocks, one_of, water);
  watch.check(*map);
  map->clear();
  watch.check(*map);
  CHECK(map->memory_bytes() == VoxelMap(0.1, params).memory_bytes());
  CHECK(memory_bytes(*map) == map->memory_bytes());
  fill(*map, water % 50, one_of, blocks);
  watch.check(*map);
}

TEST_CASE("the memory reported is the memory that malloc counts") {
  IwloParams slow;  // whose tables are larger than a small map, and whose counts take two bytes
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;
  for (const IwloParams& params : {IwloParams{}, slow}) {
    check_memory(params, 0, 1, 1);
    check_memory(params, 1, 1, 0);
    check_memory(params, 3, 3, 40);
    check_memory(params, 0, 1, 1000);
    check_memory(params, 0, 1, 70000);
    check_memory(params, 700, 3, 3000);
    check_memory(params, 3000, 1, 20000);
  }
}

TEST_CASE("pings take the memory that is reported, and leave none behind") {
  const Watch watch;
  const auto map = std::make_unique<VoxelMap>(0.05, IwloParams{});
  scenes::Random random(6);
  for (int i = 0; i < 6; ++i) {
    const scenes::Ping ping = scenes::random_ping(random);
    mapperd::map::PingParams settings;
    settings.threads = 1 + i % 3;
    integrate_evidence_grid(*map, ping.image(), scenes::random_pose(random), settings);
  }
  CHECK(bytes_of(*map) > 1e5);
  // A thread keeps the memory of its last grids for the next.
  const std::size_t before = allocations::counted();
  for (int i = 0; i < 3; ++i) {
    scenes::Random again(7);
    integrate_evidence_grid(*map, scenes::random_ping(again).image(), {}, {});
    maps::content(*map);
  }
  CHECK(static_cast<double>(allocations::counted() - before) < 3e6);
}

TEST_CASE("tiles that are dropped give their memory back") {
  const Watch watch;
  const auto map = std::make_unique<VoxelMap>(0.1, IwloParams{});
  map->cut_into_tiles({1, [](const std::vector<BlockKey>&) {}});
  std::vector<BlockKey> all, most;
  for (int b = 0; b < 1200; ++b) {
    all.push_back(key_of(b));
    if (b % 10 != 3) most.push_back(key_of(b));
  }
  put_bricks(*map, {}, all);
  const double empty = bytes_of(*map);
  fill(*map, 1000, 1, 200);
  watch.check(*map);
  const double full = bytes_of(*map) - empty;
  std::vector<mapperd::map::Voxel> kept;
  const auto voxels_of = [&map] {
    std::vector<mapperd::map::Voxel> voxels;
    for (int i = 0; i < kBlockVoxels; ++i) voxels.push_back(map->voxel(*map->find(key_of(13)), i));
    return voxels;
  };
  kept = voxels_of();
  drop_tiles(*map, most);
  watch.check(*map);
  CHECK(bytes_of(*map) - empty < 0.15 * full);
  CHECK((voxels_of() == kept && map->block_count() == 120));
  put_bricks(*map, {}, most);
  fill(*map, 1000, 1, 200);
  watch.check(*map);
  drop_tiles(*map, all);
  CHECK((map->held_count() == 0 && map->block_count() == 0));
}

#endif

}  // namespace
