// The distance field against the distance to every occupied voxel.
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "mapperd/map/distance_field.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::VoxelBox;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;

double nearest(const VoxelMap& map, const VoxelIndex& from, double max_distance_m) {
  double best = max_distance_m;
  map.for_each_known([&](const VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
    if (state.log_odds > 0.8F) {
      best = std::min(best, norm(map.centre_of(voxel) - map.centre_of(from)));
    }
  });
  return best;
}

void compare(const VoxelMap& map, const VoxelBox& box, double max_distance_m) {
  const auto field = distance_field(map, box, max_distance_m, 0.8);
  CHECK(field.size() == box.count());
  for (std::int64_t x = box.first.x; x < box.first.x + box.size[0]; ++x) {
    for (std::int64_t y = box.first.y; y < box.first.y + box.size[1]; ++y) {
      for (std::int64_t z = box.first.z; z < box.first.z + box.size[2]; ++z) {
        const VoxelIndex voxel{x, y, z};
        CHECK(field[box.place_of(voxel)] == near(nearest(map, voxel, max_distance_m), 1e-6));
      }
    }
  }
}

TEST_CASE("every distance is the distance to the nearest occupied voxel, in the box or not") {
  for (const int voxels : {1, 3, 20, 200}) {
    const VoxelMap map = maps::random_map(static_cast<std::uint64_t>(voxels), voxels, 12);
    compare(map, {{-6, -5, -4}, {11, 9, 13}}, 1.0);
    compare(map, {{-12, 7, 0}, {24, 1, 2}}, 0.37);
    compare(map, {{-8, -8, 3}, {16, 16, 1}}, 0.55);
  }
}

TEST_CASE("far truncation, an empty map, an empty box") {
  const VoxelMap empty(0.1, {});
  for (const float distance : distance_field(empty, {{0, 0, 0}, {3, 4, 5}}, 2.0, 0.8)) {
    CHECK(distance == 2.0F);
  }
  CHECK(distance_field(empty, {{0, 0, 0}, {0, 4, 5}}, 2.0, 0.8).empty());
  VoxelMap one(0.1, {});
  one.set({100, 0, 0}, {3.0F, 1});
  const auto line = distance_field(one, {{0, 0, 0}, {100, 1, 1}}, 20.0, 0.8);
  for (std::size_t x = 0; x < 100; ++x) {
    CHECK(line[x] == near(0.1 * (100.0 - static_cast<double>(x)), 1e-5));
  }
}

TEST_CASE("a field too large or without a distance is refused") {
  const VoxelMap map(0.1, {});
  const VoxelBox small{{0, 0, 0}, {2, 2, 2}};
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(distance_field(map, small, 0.0, 0.8), std::invalid_argument);
  CHECK_THROWS_AS(distance_field(map, small, nan, 0.8), std::invalid_argument);
  CHECK_THROWS_AS(distance_field(map, small, 1.0, nan), std::invalid_argument);
  CHECK_THROWS_AS(distance_field(map, small, 26.0, 0.8), std::invalid_argument);
  CHECK_THROWS_AS(distance_field(map, {{0, 0, 0}, {5000, 5000, 5000}}, 0.1, 0.8),
                  std::invalid_argument);
}

}  // namespace
