// The sampling integrator: its geometry, steps and quirks.
#include <cmath>

#include "mapperd/map/rays.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::VoxelMap;

constexpr double kDegree = 3.141592653589793 / 180;

void check_point(const Vec3& actual, const Vec3& expected) {
  CHECK(actual.x == near(expected.x, 1e-4));
  CHECK(actual.y == near(expected.y, 1e-4));
  CHECK(actual.z == near(expected.z, 1e-4));
}

TEST_CASE("the published geometry examples hold") {
  Transform down = scenes::rotation_zyx(0, 90 * kDegree, 0);
  down.translation = {0, 0, -0.5};
  check_point(down.apply(mapperd::map::fan_point(5, 30 * kDegree, 0)), {0, -2.5, -4.8301});
  check_point(down.apply(mapperd::map::fan_point(5, 0, 10 * kDegree)), {0.8682, 0, -5.4240});
}

// One bright row in every beam.
scenes::Ping wall(std::size_t beams, std::size_t row, float intensity = 145.0F) {
  scenes::Ping ping = scenes::empty_ping(100, beams, 0.6, 5.0);
  for (std::size_t j = 0; j < beams; ++j) ping.intensity[row * beams + j] = intensity;
  return ping;
}

TEST_CASE("a return is one step of the rule at its row's near edge") {
  VoxelMap map(0.1, {});
  const scenes::Ping ping = wall(64, 60);
  integrate_rays(map, ping.image(), {}, {});
  const auto hit = map.at(mapperd::map::fan_point(60 * 0.05, ping.bearings_rad[32], 0));
  CHECK(hit.count == 1);
  CHECK(hit.log_odds == near(1.75, 1e-6));
}

TEST_CASE("free space is sampled in every tenth row, from the sonar on") {
  VoxelMap map(0.02, {});
  const mapperd::map::PingStats stats = integrate_rays(map, wall(64, 60).image(), {}, {});
  CHECK(stats.free > 0);
  const double bearing = wall(64, 60).bearings_rad[31];
  CHECK(map.at(mapperd::map::fan_point(1.0, bearing, 0)).log_odds < 0);
  CHECK(map.at(mapperd::map::fan_point(1.5, bearing, 0)).log_odds < 0);
  CHECK(map.at(mapperd::map::fan_point(1.25, bearing, 0)).count == 0);   // between the samples
  CHECK(map.at(mapperd::map::fan_point(0.0, bearing, 0)).log_odds < 0);  // min_range or not
}

TEST_CASE("only every second beam of 512 is used") {
  VoxelMap map(0.01, {});
  const scenes::Ping ping = wall(512, 60);
  integrate_rays(map, ping.image(), {}, {});
  CHECK(map.at(mapperd::map::fan_point(60 * 0.05, ping.bearings_rad[100], 0)).count == 1);
  CHECK(map.at(mapperd::map::fan_point(60 * 0.05, ping.bearings_rad[101], 0)).count == 0);
}

TEST_CASE("returns more than 50 rows behind the first are not read, nor nearer than min_range") {
  VoxelMap map(0.05, {});
  scenes::Ping ping = wall(64, 40);
  for (std::size_t j = 0; j < 64; ++j) {
    ping.intensity[89 * 64 + j] = 145.0F;
    ping.intensity[90 * 64 + j] = 145.0F;
    ping.intensity[5 * 64 + j] = 145.0F;  // 0.25 m
  }
  integrate_rays(map, ping.image(), {}, {});
  const double bearing = ping.bearings_rad[32];
  CHECK(map.at(mapperd::map::fan_point(89 * 0.05, bearing, 0)).log_odds > 0);
  CHECK(map.at(mapperd::map::fan_point(90 * 0.05 + 0.049, bearing, 0.001)).count == 0);
  CHECK(map.at(mapperd::map::fan_point(5 * 0.05, bearing, 0)).log_odds <= 0);
}

TEST_CASE("the shadow test fires only with a cone wider than the beam spacing") {
  scenes::Ping ping = wall(64, 80);
  for (std::size_t k = 0; k < 100; ++k) ping.intensity[k * 64 + 32] = k == 20 ? 145.0F : 0.0F;
  const auto free_voxels = [&](double width) {
    VoxelMap map(0.1, {});
    mapperd::map::RaysParams settings;
    settings.angular_cone_width = width;
    return integrate_rays(map, ping.image(), {}, settings).free;
  };
  CHECK(free_voxels(0.4) == free_voxels(0.0));
  CHECK(free_voxels(1.0) < free_voxels(0.4));
}

TEST_CASE("the shadow test measures horizontally, so that looking down nothing is in shadow") {
  scenes::Ping ping = wall(64, 80);
  for (std::size_t k = 0; k < 100; ++k) ping.intensity[k * 64 + 32] = k == 20 ? 145.0F : 0.0F;
  const auto free_voxels = [&](double pitch, double width) {
    VoxelMap map(0.1, {});
    mapperd::map::RaysParams settings;
    settings.angular_cone_width = width;
    return integrate_rays(map, ping.image(), scenes::rotation_zyx(0, pitch, 0), settings).free;
  };
  CHECK(free_voxels(0, 1.0) < free_voxels(0, 0.4));
  CHECK(free_voxels(90 * kDegree, 1.0) == free_voxels(90 * kDegree, 0.4));
}

TEST_CASE("the first occupied intensity of a ping counts, and occupied beats free") {
  VoxelMap map(1.0, {});
  scenes::Ping ping = wall(64, 62, 145.0F);
  for (std::size_t j = 32; j < 64; ++j) ping.intensity[62 * 64 + j] = 255.0F;
  Transform pose;
  pose.translation = {0.0, 0.5, 0.5};
  integrate_rays(map, ping.image(), pose, {});
  const auto hit = map.at(mapperd::Vec3{3.05, 0.5, 0.5});
  CHECK(hit.count == 1);
  CHECK(hit.log_odds == near(1.75, 1e-6));
}

TEST_CASE("an occupied sample beats the free ones before it and behind it in a voxel") {
  VoxelMap map(1.0, {});
  scenes::Ping ping = wall(64, 62, 145.0F);
  for (std::size_t j = 32; j < 64; ++j) {
    ping.intensity[62 * 64 + j] = 0.0F;
    ping.intensity[72 * 64 + j] = 145.0F;  // free at rows 60 and 70 here
  }
  Transform pose;
  pose.translation = {0.3, 0.5, 0.5};  // rows 54 ... 73 ahead are one voxel: 60 there is free
  integrate_rays(map, ping.image(), pose, {});
  const auto hit = map.at(mapperd::Vec3{3.4, 0.5, 0.5});
  CHECK(hit.count == 1);
  CHECK(hit.log_odds == near(1.75, 1e-6));
}

}  // namespace
