// Queries against a look at every voxel.
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_walk.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::Vec3;
using mapperd::map::Occupancy;
using mapperd::map::Points;
using mapperd::map::VoxelBox;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;

constexpr mapperd::map::Thresholds kThresholds{0.8, 0.0};
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

TEST_CASE("a box holds the voxels whose centres lie in it, and boxes share none") {
  const VoxelMap map(0.1, {});
  const VoxelBox box = box_of(map, {-0.3, 0.0, 0.0}, {0.7, 0.1, 0.0});
  CHECK(box.first == (VoxelIndex{-3, 0, 0}));
  CHECK((box.size == (std::array<std::int64_t, 3>{10, 1, 0}) && box.count() == 0));
  const VoxelBox half = box_of(map, {0.04, 0.06, 0.0}, {0.16, 0.16, 0.05});
  CHECK(half.first == (VoxelIndex{0, 1, 0}));
  CHECK(half.size == (std::array<std::int64_t, 3>{2, 1, 0}));
  CHECK_THROWS_AS(box_of(map, {1, 0, 0}, {0, 1, 1}), std::invalid_argument);
  CHECK_THROWS_AS(box_of(map, {kNaN, 0, 0}, {1, 1, 1}), std::invalid_argument);
  CHECK_THROWS_AS(box_of(map, {-kInfinity, 0, 0}, {1, 1, 1}), std::invalid_argument);
  CHECK_THROWS_AS(box_of(map, {0, 0, 0}, {1e12, 1, 1}), std::invalid_argument);
  CHECK_THROWS_AS(layer_of(map, {0, 0, 0}, {1, 1, 0}, kNaN), std::invalid_argument);
  CHECK(layer_of(map, {0, 0, 0}, {1, 1, 0}, -0.01).first.z == -1);
}

TEST_CASE("a box too large for a grid is refused before anything is allocated") {
  const VoxelMap map(0.1, {});
  const VoxelBox huge = box_of(map, {-1e8, -1e8, -1e8}, {1e8, 1e8, 1e8});
  CHECK(huge.count() == std::numeric_limits<std::size_t>::max());
  CHECK_THROWS_AS(classify_box(map, huge, kThresholds), std::invalid_argument);
  CHECK(occupied_in(map, huge, 0.0).empty());
}

TEST_CASE("walking the box and walking the map visit the same voxels in the same order") {
  const VoxelMap map = maps::random_map(1, 5000, 20);
  for (const VoxelBox& box :
       {VoxelBox{{-7, -9, 3}, {12, 15, 9}}, VoxelBox{{-20, -20, -20}, {40, 40, 40}},
        VoxelBox{{-4000, -4000, -4000}, {8000, 8000, 8000}}}) {
    std::vector<VoxelIndex> expected;
    for (const maps::Entry& entry : maps::content(map)) {
      if (box.contains(entry.voxel)) expected.push_back(entry.voxel);
    }
    std::vector<VoxelIndex> visited;
    for_each_known_in(map, box, [&](const VoxelIndex& voxel, const mapperd::map::VoxelState&) {
      visited.push_back(voxel);
    });
    CHECK((!expected.empty() && visited == expected));
  }
}

TEST_CASE("points and boxes are classified as their voxels are") {
  const VoxelMap map = maps::random_map(2, 3000, 9);
  const VoxelBox box{{-10, -9, -8}, {20, 17, 13}};
  const std::vector<Occupancy> grid = classify_box(map, box, kThresholds);
  std::vector<double> xyz;
  std::vector<Occupancy> expected;
  int seen[3] = {0, 0, 0};
  for (std::int64_t x = -10; x < 10; ++x) {
    for (std::int64_t y = -9; y < 8; ++y) {
      for (std::int64_t z = -8; z < 5; ++z) {
        const VoxelIndex voxel{x, y, z};
        const Vec3 centre = map.centre_of(voxel);
        xyz.insert(xyz.end(), {centre.x, centre.y, centre.z});
        const mapperd::map::VoxelState state = map.at(voxel);
        Occupancy is = Occupancy::kUnknown;
        if (state.count > 0 && state.log_odds > 0.8F) is = Occupancy::kOccupied;
        if (state.count > 0 && state.log_odds < 0.0F) is = Occupancy::kFree;
        expected.push_back(is);
        ++seen[static_cast<int>(is) + 1];
        CHECK(grid[box.place_of(voxel)] == is);
      }
    }
  }
  CHECK((seen[0] > 100 && seen[1] > 100 && seen[2] > 100));
  CHECK(grid == expected);
  CHECK(classify(map, {xyz.data(), xyz.size() / 3}, kThresholds) == expected);
}

TEST_CASE("points beyond the reach are unknown, points that are not numbers are refused") {
  const VoxelMap map = maps::random_map(3, 10, 2);
  const double far[] = {1e30, 0, 0};
  CHECK(classify(map, {far, 1}, kThresholds)[0] == Occupancy::kUnknown);
  const double bad[] = {0, 0, 0, 0, kNaN, 0};
  CHECK_THROWS_AS(classify(map, {bad, 2}, kThresholds), std::invalid_argument);
  CHECK_THROWS_AS(classify(map, {far, 1}, {0.0, 0.1}), std::invalid_argument);
  CHECK_THROWS_AS(classify(map, {far, 1}, {0.0, kNaN}), std::invalid_argument);
  CHECK(classify(map, {nullptr, 0}, kThresholds).empty());
}

// Where a ray enters a cube, by the slab method; infinity where it runs past it.
double entry_into(const VoxelIndex& voxel, double edge, const Vec3& origin, const Vec3& unit) {
  const double from[] = {origin.x, origin.y, origin.z};
  const double slope[] = {unit.x, unit.y, unit.z};
  const std::int64_t index[] = {voxel.x, voxel.y, voxel.z};
  double entry = 0.0, exit = kInfinity;
  for (int axis = 0; axis < 3; ++axis) {
    const double low = static_cast<double>(index[axis]) * edge;
    const double a = (low - from[axis]) / slope[axis];
    const double b = (low + edge - from[axis]) / slope[axis];
    entry = std::max(entry, std::min(a, b));
    exit = std::min(exit, std::max(a, b));
  }
  return entry < exit ? entry : kInfinity;
}

TEST_CASE("a ray's depth is where it enters the nearest occupied voxel of all") {
  const VoxelMap map = maps::random_map(4, 3000, 15);
  scenes::Random random(5);
  int hits = 0, misses = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 origin{random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-2, 2)};
    const Vec3 unit = mapperd::map::unit_vector(
        {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)});
    double expected = kInfinity;
    map.for_each_known([&](const VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
      if (state.log_odds > 0.8F) {
        expected = std::min(expected, entry_into(voxel, map.resolution_m(), origin, unit));
      }
    });
    const double from[] = {origin.x, origin.y, origin.z};
    const double scale = std::pow(10.0, random.integer(-200, 200));
    const double along[] = {unit.x * scale, unit.y * scale, unit.z * scale};
    const double depth = ray_cast_depth(map, {from, 1}, {along, 1}, 1.5, 0.8)[0];
    CHECK(depth == near(expected <= 1.5 ? expected : -1.0, 1e-12));
    ++(depth < 0 ? misses : hits);
  }
  CHECK((hits > 200 && misses > 200));
}

TEST_CASE("a vector of any length has one of length 1 along it") {
  constexpr double kLargest = std::numeric_limits<double>::max();
  constexpr double kSmallest = std::numeric_limits<double>::denorm_min();
  for (const double length : {1.0, 1e-200, 1e200, kLargest, kSmallest}) {
    const Vec3 along = mapperd::map::unit_vector({0.0, -length, length});
    CHECK(along.x == 0.0);
    CHECK(along.y == near(-std::sqrt(0.5), 1e-15));
    CHECK(along.z == near(std::sqrt(0.5), 1e-15));
  }
}

TEST_CASE("rays along axes, from inside, through edges, and of no length") {
  VoxelMap map(0.1, {});
  map.set({5, 0, 0}, {3.0F, 1});
  map.set({0, 5, 0}, {3.0F, 1});
  map.set({2, 3, 0}, {3.0F, 1});
  const auto depth = [&map](const Vec3& o, const Vec3& d, double range) {
    const double from[] = {o.x, o.y, o.z};
    const double along[] = {d.x, d.y, d.z};
    return ray_cast_depth(map, {from, 1}, {along, 1}, range, 0.8)[0];
  };
  CHECK(depth({0.05, 0.05, 0.05}, {1, 0, 0}, 10) == near(0.45, 1e-15));
  CHECK(depth({0.05, 0.05, 0.05}, {0, 7, 0}, 10) == near(0.45, 1e-15));
  CHECK(depth({0.95, 0.05, 0.05}, {-1, 0, 0}, 10) == near(0.35, 1e-15));
  CHECK(depth({0.05, 0.05, 0.05}, {-1, 0, 0}, 10) == -1.0);
  CHECK(depth({0.55, 0.05, 0.05}, {0, 0, -1}, 10) == 0.0);
  CHECK(depth({0.55, 0.05, 0.05}, {0, 0, -1}, 0) == 0.0);
  CHECK(depth({0.05, 0.05, 0.05}, {1, 0, 0}, 0.449) == -1.0);
  // The diagonal touches the voxel (2, 3) in an edge alone.
  CHECK(depth({0.0, 0.0, 0.05}, {1, 1, 0}, 10) == -1.0);
  CHECK_THROWS_AS(depth({0, 0, 0}, {0, 0, 0}, 1), std::invalid_argument);
  CHECK_THROWS_AS(depth({0, 0, 0}, {kNaN, 0, 1}, 1), std::invalid_argument);
  CHECK_THROWS_AS(depth({0, kInfinity, 0}, {1, 0, 0}, 1), std::invalid_argument);
  CHECK_THROWS_AS(depth({1e30, 0, 0}, {1, 0, 0}, 1), std::invalid_argument);
  CHECK_THROWS_AS(depth({0, 0, 0}, {1, 0, 0}, kNaN), std::invalid_argument);
  CHECK_THROWS_AS(depth({0, 0, 0}, {1, 0, 0}, -1), std::invalid_argument);
  CHECK_THROWS_AS(depth({0, 0, 0}, {1, 0, 0}, kInfinity), std::invalid_argument);
}

TEST_CASE("a threshold below 0 is of what was seen: rays run on through what was not") {
  VoxelMap map(0.1, {});
  map.set({3, 0, 0}, {-1.0F, 1});
  map.set({5, 0, 0}, {-0.2F, 1});
  const double from[] = {0.05, 0.05, 0.05};
  const double along[] = {1, 0, 0};
  CHECK(ray_cast_depth(map, {from, 1}, {along, 1}, 10.0, -0.5)[0] == near(0.45, 1e-15));
  CHECK(ray_cast_depth(map, {from, 1}, {along, 1}, 10.0, -0.1)[0] == -1.0);
}

TEST_CASE("depths far from the origin equal those at it") {
  constexpr std::int64_t kFar = 100'000'000;  // 10 000 km
  VoxelMap map(0.125, {});                    // exact in binary, so that both places are
  map.set({9, 3, 2}, {3.0F, 1});
  map.set({kFar + 9, 3, 2}, {3.0F, 1});
  const double from[] = {0.01, 0.02, 0.03, 0.01 + 0.125 * kFar, 0.02, 0.03};
  const double along[] = {9.3, 3.4, 2.5, 9.3, 3.4, 2.5};
  const auto depths = ray_cast_depth(map, {from, 2}, {along, 2}, 5.0, 0.8);
  CHECK(depths[0] > 0);
  CHECK(depths[1] == near(depths[0], 1e-8));
}

TEST_CASE("occupied voxels of a region, and the number of known ones") {
  const VoxelMap map = maps::random_map(6, 2000, 10);
  const VoxelBox box{{-5, -4, -3}, {9, 8, 7}};
  const auto found = occupied_in(map, box, 0.8);
  std::size_t expected = 0;
  for (const maps::Entry& entry : maps::content(map)) {
    if (box.contains(entry.voxel) && entry.state.log_odds > 0.8F) ++expected;
  }
  CHECK((expected > 10 && found.size() == expected));
  for (const auto& [voxel, state] : found) {
    CHECK((box.contains(voxel) && state.log_odds > 0.8F));
    CHECK((maps::Entry{voxel, state} == maps::Entry{voxel, map.at(voxel)}));
  }
  CHECK(known_count(map) == maps::content(map).size());
  VoxelMap one(0.1, {});
  one.set({0, 0, 0}, {0.5F, 1});
  CHECK((occupied_in(one, box, 0.5).empty() && occupied_in(one, box, 0.499).size() == 1));
}

}  // namespace
