// Far-field pings with ragged first returns: every shortcut gives what the voxel gives on its own.
#include <cmath>
#include <cstdio>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/projective.hpp"

namespace {

using mapperd::map::Aggregation;
using mapperd::map::FanSettings;
using mapperd::Vec3;
using mapperd::map::VoxelMap;
using oracle::Class;
using oracle::Parts;
using scenes::Ragged;

// Sanitizer builds look at a few points only.
int points_of_scene() { return check::sanitized() ? 300 : 6000; }

// Into an empty map.
double expected_log_odds(const mapperd::map::IwloRule& rule, const Parts& parts,
                         const FanSettings& settings) {
  const Class own = oracle::class_of(parts);
  if (own == Class::untouched) return 0.0;
  const double down = rule.free_step(0, 0);
  if (own == Class::free) return down;
  const double up = rule.occupied_step(0, 0, parts.weight());
  if (settings.aggregation == Aggregation::occupied_first) return up;
  return (parts.occupied * up + parts.free * down) / (parts.occupied + parts.free);
}

struct Tally {
  int looked = 0;
  int occupied = 0;
  int free = 0;
  int untouched = 0;
};

Tally compare(scenes::Random& random, const scenes::Ping& ping, const FanSettings& settings,
              double edge_m) {
  VoxelMap map(edge_m, {});
  const mapperd::Transform pose = scenes::random_pose(random);
  mapperd::map::integrate_projective(map, ping.image(), pose, settings);
  const mapperd::map::Fan fan(ping.image(), settings, map.rule(), pose);
  const scenes::Borders borders(ping, settings, edge_m);
  Tally tally;
  for (int i = 0; i < points_of_scene(); ++i) {
    mapperd::map::VoxelIndex voxel;
    CHECK(map.index_of(pose.apply(borders.point(random)), voxel));
    const Vec3 centre = map.centre_of(voxel);
    const Parts parts = scenes::parts_on_its_own(fan, centre - pose.translation, edge_m);
    // Rounding decides there; the walk may have settled it by symmetry.
    if (oracle::distance_to_limit(parts) < 1e-4) continue;
    const mapperd::map::VoxelState state = map.at(voxel);
    const Class own = oracle::class_of(parts);
    ++(own == Class::occupied ? tally.occupied : own == Class::free ? tally.free : tally.untouched);
    ++tally.looked;
    CHECK((state.count == 0) == (own == Class::untouched));
    CHECK_NEAR(state.log_odds, expected_log_odds(map.rule(), parts, settings), 2e-4);
  }
  return tally;
}

// `voxels` along the range.
void check_scene(std::uint64_t seed, const Ragged& want, const FanSettings& settings,
                 double voxels) {
  scenes::Random random(seed);
  const scenes::Ping ping = scenes::ragged_ping(want, random);
  const Tally t = compare(random, ping, settings, want.max_range_m / voxels);
  std::printf("  %d voxels: %d occupied, %d free, %d untouched\n", t.looked, t.occupied, t.free,
              t.untouched);
  CHECK(t.occupied > t.looked / 50 && t.free > t.looked / 50 && t.untouched > t.looked / 50);
}

FanSettings with_aperture(double aperture_rad) {
  FanSettings settings;
  settings.vertical_aperture_rad = aperture_rad;
  settings.min_range_m = 0.02;
  return settings;
}

TEST_CASE("far field: beams much narrower than voxels, single rows of returns") {
  Ragged want;
  want.beams = 512;
  FanSettings settings = with_aperture(0.2);
  check_scene(101, want, settings, 200);
  want.jump = 0.02;  // returns near to each other: in the near and far slices of one voxel
  want.silent = 0.4;
  check_scene(102, want, settings, 120);
  settings.carve_no_return = true;
  check_scene(103, want, settings, 160);
}

TEST_CASE("far field: beams wider than voxels") {
  Ragged want;
  want.beams = 20;
  want.jump = 0.5;
  FanSettings settings = with_aperture(0.25);
  check_scene(111, want, settings, 200);
  settings.carve_no_return = true;
  want.beams = 48;
  want.silent = 0.5;
  check_scene(112, want, settings, 150);
}

TEST_CASE("far field: as wide as voxels, thick echoes with gaps, stray returns") {
  Ragged want;
  want.beams = 128;
  want.thickness = 12;
  want.nearer = 0.2;
  FanSettings settings = with_aperture(0.3);
  check_scene(121, want, settings, 180);
  want.rows = 900;  // many rows a voxel
  check_scene(122, want, settings, 120);
  want.rows = 90;  // rows thicker than voxels
  settings.aggregation = Aggregation::mean;
  check_scene(123, want, settings, 130);
}

TEST_CASE("far field: a narrow fan is cut by its sides, a thin one by its aperture") {
  Ragged want;
  want.beams = 64;
  want.half_fan_rad = 0.04;
  check_scene(131, want, with_aperture(0.1), 300);
  want.half_fan_rad = 1.2;
  want.beams = 256;
  check_scene(132, want, with_aperture(0.02), 140);
  check_scene(133, want, with_aperture(0.006), 250);
}

TEST_CASE("far field: what is nearer than min_range says nothing") {
  Ragged want;
  want.beams = 200;
  want.nearer = 0.5;  // many of the first returns lie before it
  want.silent = 0.3;
  FanSettings settings = with_aperture(0.2);
  settings.min_range_m = 0.45 * want.max_range_m;
  check_scene(141, want, settings, 150);
  settings.carve_no_return = true;
  settings.min_range_m = 0.303 * want.max_range_m;
  check_scene(142, want, settings, 110);
}

TEST_CASE("beside the sonar: voxels thicker than the fan, which both of its cones cross") {
  Ragged want;
  want.half_fan_rad = 1.1;
  want.silent = 0.3;
  want.max_range_m = 1.0;
  Tally total;
  for (std::uint64_t scene = 0; scene < 8; ++scene) {
    scenes::Random random(150 + scene);
    want.beams = scene % 2 == 0 ? 24 : 200;
    FanSettings settings = with_aperture(random.uniform(0.01, 0.06));
    settings.min_range_m = 0.0;
    settings.carve_no_return = true;
    const scenes::Ping ping = scenes::ragged_ping(want, random);
    const Tally t = compare(random, ping, settings, want.max_range_m / random.uniform(15, 80));
    total.occupied += t.occupied;
    total.free += t.free;
  }
  std::printf("  %d occupied, %d free\n", total.occupied, total.free);
  CHECK(total.occupied > points_of_scene() / 20 && total.free > points_of_scene() / 20);
}

}  // namespace
