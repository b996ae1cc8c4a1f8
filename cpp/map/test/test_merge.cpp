#include <algorithm>
#include <stdexcept>

#include "mapperd/map/merge.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::IwloParams;
using mapperd::map::VoxelMap;

TEST_CASE("merging adds log-odds and counts, between the clamps") {
  VoxelMap map = maps::random_map(1, 2000, 8);
  const VoxelMap before = maps::random_map(1, 2000, 8);
  const VoxelMap other = maps::random_map(2, 2000, 8);
  merge(map, {&other});
  int in_both = 0;
  for (std::int64_t x = -9; x < 9; ++x) {
    for (std::int64_t y = -9; y < 9; ++y) {
      for (std::int64_t z = -9; z < 9; ++z) {
        const mapperd::map::VoxelIndex voxel{x, y, z};
        const auto a = before.at(voxel), b = other.at(voxel), sum = map.at(voxel);
        CHECK(sum.log_odds == near(std::clamp(a.log_odds + b.log_odds, -10.0F, 10.0F), 1e-6));
        CHECK(sum.count == std::min<int>(a.count + b.count, map.rule().settled_count()));
        if (a.count > 0 && b.count > 0) ++in_both;
      }
    }
  }
  CHECK(in_both > 100);
}

TEST_CASE("the order of the merged maps does not matter, to the bit, even at the clamps") {
  IwloParams tight;
  tight.L_min = -4.0;
  tight.L_max = 3.0;
  const VoxelMap parts[] = {maps::random_map(1, 1500, 6, tight),
                            maps::random_map(2, 1500, 6, tight),
                            maps::random_map(3, 1500, 6, tight), maps::random_map(4, 9, 6, tight)};
  int order[] = {0, 1, 2, 3};
  std::vector<maps::Entry> first;
  do {
    VoxelMap empty(0.1, tight);
    merge(empty, {&parts[order[0]], &parts[order[1]], &parts[order[2]], &parts[order[3]]});
    if (first.empty()) first = maps::content(empty);
    CHECK((!first.empty() && maps::content(empty) == first));
  } while (std::next_permutation(std::begin(order), std::end(order)));
  // Which map takes the others does not matter either.
  VoxelMap taker = maps::random_map(2, 1500, 6, tight);
  merge(taker, {&parts[3], &parts[0], &parts[2]});
  CHECK(maps::content(taker) == first);
}

TEST_CASE("merging with nothing, and an empty map, changes nothing") {
  VoxelMap map = maps::random_map(1, 500, 6);
  const auto before = maps::content(map);
  const VoxelMap empty(0.1, {});
  merge(map, {});
  merge(map, {&empty});
  CHECK(maps::content(map) == before);
  VoxelMap copy(0.1, {});
  merge(copy, {&map});
  CHECK(maps::content(copy) == before);
}

TEST_CASE("maps of different kinds are refused and nothing changes") {
  VoxelMap map = maps::random_map(1, 500, 6);
  const auto before = maps::content(map);
  const VoxelMap good = maps::random_map(2, 500, 6);
  const VoxelMap coarse(0.2, {});
  IwloParams clamps, counts;
  clamps.L_max = 9.0;
  counts.decay_rate = 0.2;
  const VoxelMap clamped(0.1, clamps), counted(0.1, counts);
  CHECK_THROWS_AS(merge(map, {&good, &coarse}), std::invalid_argument);
  CHECK_THROWS_AS(merge(map, {&good, &clamped}), std::invalid_argument);
  CHECK_THROWS_AS(merge(map, {&good, &counted}), std::invalid_argument);
  CHECK_THROWS_AS(merge(map, {&good, &map}), std::invalid_argument);
  CHECK(maps::content(map) == before);
}

TEST_CASE("another rule keeps the content, inside its clamps") {
  const VoxelMap map = maps::random_map(1, 500, 6);
  CHECK(maps::content(with_rule(map, {})) == maps::content(map));
  IwloParams tight;
  tight.L_min = -1.0;
  tight.L_max = 2.0;
  tight.min_alpha = 0.5;
  const VoxelMap bounded = with_rule(map, tight);
  map.for_each_known(
      [&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
        CHECK(bounded.at(voxel).log_odds == std::clamp(state.log_odds, -1.0F, 2.0F));
        CHECK(bounded.at(voxel).count == std::min<int>(state.count, 10));
      });
  CHECK(bounded.rule().params().L_max == 2.0);
}

}  // namespace
