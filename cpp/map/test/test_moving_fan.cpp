// Of a moving sonar, too, every shortcut gives what the voxel gives on its own.
#include <cmath>
#include <cstdio>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/projective.hpp"
#include "mapperd/map/voxel_lines.hpp"
#include "moving_scenes.hpp"

namespace {

using mapperd::map::FanSettings;
using mapperd::map::PingMotion;
using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::VoxelMap;
using oracle::Class;
using oracle::Parts;
using scenes::Ragged;

// Sanitizer builds look at a few points only.
int points_of_scene() { return check::sanitized() ? 300 : 5000; }

Class class_of(const mapperd::map::VoxelState& state) {
  if (state.count == 0) return Class::untouched;
  return state.log_odds < 0 ? Class::free : Class::occupied;
}

struct Tally {
  int occupied = 0;
  int free = 0;
  int untouched = 0;
};

Tally compare(scenes::Random& random, const scenes::Ping& ping, const FanSettings& settings,
              double edge_m, const PingMotion& motion) {
  VoxelMap map(edge_m, {});
  const Transform pose = scenes::random_pose(random);
  mapperd::map::integrate_projective(map, ping.image(), pose, settings, motion);
  Transform start = mapperd::map::turned_to_transmission(pose, motion);
  start.translation = pose.translation - motion.valid_s * motion.linear_mps;
  const mapperd::map::Fan fan(ping.image(), settings, map.rule(), start, motion);
  const scenes::Borders borders(ping, settings, edge_m);
  Tally tally;
  for (int i = 0; i < points_of_scene(); ++i) {
    const Vec3 seen = start.rotate(borders.point(random));
    mapperd::map::VoxelIndex voxel;
    CHECK(map.index_of(fan.view()->place_of(seen) + start.translation, voxel));
    const Parts parts =
        scenes::parts_on_its_own(fan, map.centre_of(voxel) - start.translation, edge_m);
    if (oracle::distance_to_limit(parts) < 1e-4) continue;
    const Class own = oracle::class_of(parts);
    const mapperd::map::VoxelState state = map.at(voxel);
    CHECK(class_of(state) == own);
    if (own == Class::occupied) {
      CHECK_NEAR(state.log_odds, map.rule().occupied_step(0, 0, parts.weight()), 2e-4);
    }
    ++(own == Class::occupied ? tally.occupied : own == Class::free ? tally.free : tally.untouched);
  }
  return tally;
}

// `speed` and `turn` as parts of what is allowed at most.
void check_scene(std::uint64_t seed, const Ragged& want, FanSettings settings, double voxels,
                 double speed, double turn) {
  scenes::Random random(seed);
  const scenes::Ping ping = scenes::ragged_ping(want, random);
  const double most_rate = 1500.0 / 2 / want.max_range_m;
  const PingMotion motion = scenes::motion_of(29.9 * speed, 0.99 * most_rate * turn, random);
  if (check::sanitized() && voxels > 100) voxels /= 2;
  const Tally t = compare(random, ping, settings, want.max_range_m / voxels, motion);
  std::printf("  %d occupied, %d free, %d untouched\n", t.occupied, t.free, t.untouched);
  const int least = points_of_scene() / 150;
  CHECK(t.occupied > least && t.free > least && t.untouched > least);
}

FanSettings with_aperture(double aperture_rad) {
  FanSettings settings;
  settings.vertical_aperture_rad = aperture_rad;
  settings.min_range_m = 0.02;
  return settings;
}

TEST_CASE("moving: beams narrower than voxels, single rows of returns") {
  Ragged want;
  want.beams = 512;
  FanSettings settings = with_aperture(0.2);
  check_scene(701, want, settings, 180, 0.03, 0.01);
  want.jump = 0.02;
  want.silent = 0.4;
  check_scene(702, want, settings, 120, 0.1, 0.05);
  settings.carve_no_return = true;
  check_scene(703, want, settings, 150, 1.0, 0.4);
}

TEST_CASE("moving: beams wider than voxels") {
  Ragged want;
  want.beams = 20;
  want.jump = 0.5;
  FanSettings settings = with_aperture(0.25);
  check_scene(711, want, settings, 180, 0.03, 0.02);
  settings.carve_no_return = true;
  want.beams = 48;
  want.silent = 0.5;
  check_scene(712, want, settings, 150, 0.0, 0.1);
  check_scene(713, want, settings, 100, 1.0, 1.0);
}

TEST_CASE("moving: thick echoes with gaps, stray returns, a narrow fan and a thin one") {
  Ragged want;
  want.thickness = 12;
  want.nearer = 0.2;
  check_scene(721, want, with_aperture(0.3), 160, 0.1, 0.1);
  want.half_fan_rad = 0.04;
  want.beams = 64;
  want.thickness = 1;
  check_scene(722, want, with_aperture(0.1), 250, 0.05, 0.05);
  want.half_fan_rad = 1.2;
  want.beams = 256;
  check_scene(723, want, with_aperture(0.02), 140, 0.05, 0.05);
}

TEST_CASE("moving: beside the sonar, and nothing nearer than min_range") {
  Ragged want;
  want.beams = 200;
  want.nearer = 0.5;
  want.silent = 0.3;
  FanSettings settings = with_aperture(0.2);
  settings.min_range_m = 0.45 * want.max_range_m;
  check_scene(731, want, settings, 130, 0.1, 0.1);
  want.max_range_m = 1.0;
  settings.min_range_m = 0.0;
  settings.carve_no_return = true;
  check_scene(732, want, settings, 30, 0.5, 0.05);
}

// A ping of a sonar that turns by a third of a radian.
mapperd::map::Fan turning_fan(scenes::Random& random, const scenes::Ping& ping,
                         const FanSettings& settings) {
  const PingMotion motion = scenes::motion_of(20, 1500.0 / 2 / 20 / 3, random);
  return {ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random), motion};
}

TEST_CASE("moving: the parts of a voxel inside one kind of evidence are its volume") {
  scenes::Random random(741);
  scenes::Ping ping = scenes::empty_ping(100, 40, 1.0, 20.0);
  for (std::size_t j = 0; j < 40; ++j) {
    for (std::size_t k = 60; k < 100; ++k) ping.intensity[k * 40 + j] = 200.0F;
  }
  const FanSettings settings = with_aperture(0.5);
  const mapperd::map::Fan fan = turning_fan(random, ping, settings);
  for (int i = 0; i < 100; ++i) {
    const bool is_free = i % 2 == 0;
    const double range = is_free ? random.uniform(3, 11) : random.uniform(13, 19);
    const Vec3 seen = fan.to_map(
        mapperd::map::fan_point(range, random.uniform(-0.8, 0.8), random.uniform(-0.15, 0.15)));
    const Parts parts = scenes::parts_on_its_own(fan, fan.view()->place_of(seen), 0.2);
    CHECK_NEAR(parts.free, is_free ? 1.0 : 0.0, 1e-7);
    CHECK_NEAR(parts.occupied, is_free ? 0.0 : 1.0, 1e-7);
  }
}

TEST_CASE("moving: lines through voxels give the parts of the exact integral") {
  scenes::Random random(742);
  Ragged want;
  want.thickness = 6;
  want.beams = 60;
  const scenes::Ping ping = scenes::ragged_ping(want, random);
  const FanSettings settings = with_aperture(0.3);
  const mapperd::map::Fan fan = turning_fan(random, ping, settings);
  const double edge_m = 0.3;
  const mapperd::map::VoxelLines lines(fan, edge_m, mapperd::map::kernels());
  const scenes::Borders borders(ping, settings, edge_m);
  double worst = 0, squared = 0;
  int compared = 0;
  for (int i = 0; i < 1500; ++i) {
    const Vec3 at = i % 2 == 0 ? borders.corner(random) : borders.point(random);
    const Vec3 place = fan.view()->place_of(fan.to_map(at));
    const mapperd::map::Seen seen = fan.view()->look(place);
    const mapperd::map::Fan::Verdict verdict = fan.verdict(place, edge_m);
    if (verdict.content != mapperd::map::Fan::Content::undecided) continue;
    mapperd::map::LineTask task;
    const mapperd::map::Cube cube{{seen.at.x, seen.at.y, seen.at.z}, edge_m / 2, &seen.axes};
    if (!lines.prepare(cube, verdict.where, task)) continue;
    const mapperd::map::Evidence sum = lines.sample(task, 128).sum;
    const Parts exact = scenes::parts_on_its_own(fan, place, edge_m);
    const double error =
        std::max(std::abs(sum.occupied - exact.occupied), std::abs(sum.free - exact.free));
    worst = std::max(worst, error);
    squared += error * error;
    ++compared;
  }
  const double rms = std::sqrt(squared / compared);
  std::printf("  %d voxels: parts off by %.4f rms, %.3f worst\n", compared, rms, worst);
  CHECK(compared > 300);
  CHECK(rms < 0.006 && worst < 0.04);
}

}  // namespace
