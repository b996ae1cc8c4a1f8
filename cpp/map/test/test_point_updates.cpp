#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "mapperd/map/merge.hpp"
#include "mapperd/map/point_updates.hpp"
#include "mapperd/map/snapshot.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::Vec3;
using mapperd::map::StepLimits;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;

constexpr StepLimits kLimits{-2.0, 3.5};
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

TEST_CASE("the published vectors of the rule, through points with weights") {
  // The original rule's test vectors, set A.
  VoxelMap map(0.05, {});
  const double xyz[] = {0.01, 0.02, 0.03, 0.04, 0.02, 0.01, 0.0, 0.0, 0.0};  // all in one voxel
  const double intensity[] = {145, 0, 145};
  const bool occupied[] = {true, false, true};
  const double weights[] = {3, 2, 1};
  observe(map, {{xyz, 1}, intensity, occupied, weights});
  CHECK(map.at(VoxelIndex{}).log_odds == near(5.25, 1e-6));
  observe(map, {{xyz + 3, 2}, intensity + 1, occupied + 1, weights + 1});
  CHECK(map.at(VoxelIndex{}).log_odds == near(5.032107, 1.5 * map.rule().unit()));  // three steps
  CHECK(map.at(VoxelIndex{}).count == 3);
  VoxelMap plain(0.05, {});
  observe(plain, {{xyz, 3}, intensity, occupied, nullptr});
  CHECK(plain.at(VoxelIndex{}).count == 3);
  CHECK(known_count(plain) == 1);
}

TEST_CASE("the flag decides, not the intensity: dark but occupied is no evidence of free") {
  VoxelMap map(0.05, {});
  const double xyz[] = {0, 0, 0, 1, 1, 1};
  const double intensity[] = {10, 200};
  const bool occupied[] = {true, false};
  observe(map, {{xyz, 2}, intensity, occupied, nullptr});
  CHECK((map.at(Vec3{0, 0, 0}).log_odds == 0.0F && map.at(Vec3{0, 0, 0}).count == 1));
  CHECK(map.at(Vec3{1, 1, 1}).log_odds == near(-3.0, 1e-6));
}

TEST_CASE("steps stop at their limits and never bring back what is beyond") {
  VoxelMap map(0.1, {});
  const double xyz[] = {0, 0, 0};
  const double up = 1.0, down = -1.0, nine = 9.0;
  for (int i = 0; i < 6; ++i) add_log_odds(map, {xyz, 1}, &up, kLimits);
  CHECK((map.at(VoxelIndex{}).log_odds == 3.5F && map.at(VoxelIndex{}).count == 6));
  set_log_odds(map, {xyz, 1}, &nine);
  add_log_odds(map, {xyz, 1}, &up, kLimits);
  CHECK(map.at(VoxelIndex{}).log_odds == 9.0F);
  add_log_odds(map, {xyz, 1}, &down, kLimits);
  CHECK(map.at(VoxelIndex{}).log_odds == 8.0F);
  for (int i = 0; i < 200; ++i) add_log_odds(map, {xyz, 1}, &down, kLimits);
  CHECK((map.at(VoxelIndex{}).log_odds == -2.0F && map.at(VoxelIndex{}).count == 90));
}

TEST_CASE("set values are absolute and clamped by the map") {
  VoxelMap map(0.1, {});
  const double xyz[] = {0, 0, 0, 1, 0, 0};
  const double values[] = {50.0, -50.0};
  set_log_odds(map, {xyz, 2}, values);
  set_log_odds(map, {xyz, 2}, values);
  CHECK((map.at(Vec3{0, 0, 0}).log_odds == 10.0F && map.at(Vec3{0, 0, 0}).count == 2));
  CHECK(map.at(Vec3{1, 0, 0}).log_odds == -10.0F);
  const double enormous[] = {-1e300, 1e300};
  set_log_odds(map, {xyz, 2}, enormous);
  CHECK((map.at(Vec3{0, 0, 0}).log_odds == -10.0F && map.at(Vec3{1, 0, 0}).log_odds == 10.0F));
}

TEST_CASE("log-odds are kept to their unit, through sums and other rules") {
  VoxelMap map(0.1, {});
  const double xyz[] = {0, 0, 0};
  const double odd = 9.0 + map.rule().unit(), half = 0.5;
  const auto units = [](const VoxelMap& of) { return dense_blocks(of, 0, 1).units.at(0); };
  const std::int32_t expected = 9 * (1 << 24) + (1 << 13);
  set_log_odds(map, {xyz, 1}, &odd);
  CHECK(units(map) == expected);
  VoxelMap sum(0.1, {});
  merge(sum, {&map});
  CHECK((units(sum) == expected && units(with_rule(map, {})) == expected));
  add_log_odds(map, {xyz, 1}, &half, {-2, 10});
  CHECK(units(map) == expected + (1 << 23));
}

TEST_CASE("points all over the blocks give what one call a point gives") {
  VoxelMap together(0.1, {}), alone(0.1, {});
  scenes::Random random(8);
  std::vector<double> xyz, intensity, weights;
  bool occupied[3000];
  for (bool& flag : occupied) {
    for (int axis = 0; axis < 3; ++axis) xyz.push_back(random.uniform(-2, 2));
    if (random.integer(0, 3) == 0) std::fill(xyz.end() - 3, xyz.end(), 0.5);  // many in one voxel
    intensity.push_back(random.uniform(0, 255));
    weights.push_back(random.uniform(0, 2));
    flag = random.integer(0, 1) == 1;
  }
  observe(together, {{xyz.data(), 3000}, intensity.data(), occupied, weights.data()});
  for (std::size_t i = 0; i < 3000; ++i) {
    observe(alone, {{&xyz[3 * i], 1}, &intensity[i], &occupied[i], &weights[i]});
  }
  CHECK(maps::content(together) == maps::content(alone));
  CHECK(known_count(alone) > 2000);
}

TEST_CASE("a bad point anywhere leaves the map as it was") {
  VoxelMap map(0.1, {});
  const double nan_point[] = {0, 0, 0, 0, kNaN, 0};
  const double far_point[] = {0, 0, 0, 1e30, 0, 0};
  const double good[] = {0, 0, 0, 1, 1, 1};
  const double steps[] = {1.0, 1.0};
  const double bad_steps[] = {1.0, kNaN};
  const double bad_weights[] = {1.0, -1.0};
  const bool occupied[] = {true, true};
  CHECK_THROWS_AS(add_log_odds(map, {nan_point, 2}, steps, kLimits), std::invalid_argument);
  CHECK_THROWS_AS(add_log_odds(map, {far_point, 2}, steps, kLimits), std::invalid_argument);
  CHECK_THROWS_AS(add_log_odds(map, {good, 2}, bad_steps, kLimits), std::invalid_argument);
  CHECK_THROWS_AS(set_log_odds(map, {good, 2}, bad_steps), std::invalid_argument);
  CHECK_THROWS_AS(observe(map, {{good, 2}, steps, occupied, bad_weights}), std::invalid_argument);
  CHECK_THROWS_AS(observe(map, {{good, 2}, bad_steps, occupied, nullptr}), std::invalid_argument);
  CHECK_THROWS_AS(add_ray(map, {0, 0, 0}, {kNaN, 0, 0}, 1, -1, kLimits), std::invalid_argument);
  CHECK_THROWS_AS(add_ray(map, {0, 0, 0}, {1e7, 0, 0}, 1, -1, kLimits), std::invalid_argument);
  CHECK(known_count(map) == 0);
}

TEST_CASE("a ray frees what finer and finer steps find, and ends occupied") {
  scenes::Random random(7);
  for (int i = 0; i < 200; ++i) {
    VoxelMap map(0.1, {});
    const Vec3 a{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    const Vec3 b{random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
    add_ray(map, a, b, 0.85, -0.4, kLimits);
    std::size_t stepped_free = 0;
    VoxelIndex last{999, 0, 0};
    for (int k = 0; k <= 4000; ++k) {
      const Vec3 at = a + (k / 4000.0) * (b - a);
      VoxelIndex voxel, end;
      CHECK((map.index_of(at, voxel) && map.index_of(b, end)));
      if (voxel == end || voxel == last) continue;
      last = voxel;
      ++stepped_free;
      CHECK(map.at(voxel).log_odds == near(-0.4, 0.5 * map.rule().unit()));
      CHECK(map.at(voxel).count == 1);
    }
    CHECK(map.at(b).log_odds == near(0.85, 0.5 * map.rule().unit()));
    // Steps may miss a corner that the ray cuts; they cannot find too much.
    const std::size_t freed = known_count(map) - 1;
    CHECK((freed >= stepped_free && freed <= stepped_free + 2));
  }
  VoxelMap map(0.1, {});
  add_ray(map, {0.05, 0, 0}, {0.05, 0, 0}, 0.85, -0.4, kLimits);
  CHECK(known_count(map) == 1);
}

}  // namespace
