// error_bound, end to end: how far a sampled ping is from the exact one.
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/projective.hpp"

namespace {

using mapperd::map::Aggregation;
using mapperd::map::FanSettings;
using mapperd::map::VoxelMap;
using oracle::Class;
using oracle::Parts;
using scenes::Ragged;

struct Shares {
  double occupied = 0;  // voxels
  double off = 0;       // of those that both call occupied, by more than the bound
  double disputed = 0;  // occupied in one of them only
  double free = 0;      // voxels
  double edges = 0;     // free in one and untouched in the other
  double far = 0;       // of these, those that are not near to a limit

  void add(const Shares& other) {
    occupied += other.occupied;
    off += other.off;
    disputed += other.disputed;
    free += other.free;
    edges += other.edges;
    far += other.far;
  }
};

Class class_of(const mapperd::map::VoxelState& state, double free_step) {
  if (state.count == 0) return Class::untouched;
  // One ping on an empty map: a free step, or anything above it.
  return state.log_odds <= free_step + 1e-4 ? Class::free : Class::occupied;
}

struct Shot {
  scenes::Ping ping;
  FanSettings settings;
  mapperd::Transform pose;
  double edge_m;
};

void print(double bound, const Shares& s) {
  std::printf(
      "  bound %.2f: %.0f occupied, %.3f %% off by more, %.3f %% in dispute; %.0f free, %.3f %% in "
      "dispute; %.0f of these not near a limit\n",
      bound, s.occupied, 100 * s.off / s.occupied, 100 * s.disputed / s.occupied, s.free,
      100 * s.edges / s.free, s.far);
}

// How near the sum that decides the class is to its limit.
bool near_limit(const Shot& shot, const mapperd::map::Fan& fan, const mapperd::Vec3& centre) {
  const Parts own = scenes::parts_on_its_own(fan, centre - shot.pose.translation, shot.edge_m);
  return oracle::distance_to_limit(own) <= 0.1 || std::abs(own.occupied - 0.02) <= 0.1;
}

constexpr std::array<double, 3> kBounds{0.05, 0.2, 0.5};
using SharesByBound = std::array<Shares, kBounds.size()>;

Shares compared(const Shot& shot, const mapperd::map::Fan& fan, const VoxelMap& exact, double bound) {
  FanSettings settings = shot.settings;
  settings.error_bound = bound;
  VoxelMap sampled(shot.edge_m, {});
  integrate_projective(sampled, shot.ping.image(), shot.pose, settings);
  const double free_step = exact.rule().free_step(0, 0);
  Shares shares;
  const auto dispute = [&](const mapperd::map::VoxelIndex& voxel, Class one, Class other) {
    const bool occupied = one == Class::occupied || other == Class::occupied;
    ++(occupied ? shares.disputed : shares.edges);
    if (!near_limit(shot, fan, exact.centre_of(voxel))) ++shares.far;
  };
  exact.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& a) {
    const mapperd::map::VoxelState b = sampled.at(voxel);
    const Class is = class_of(b, free_step), was = class_of(a, free_step);
    if (was == Class::occupied) ++shares.occupied;
    if (was == Class::free) ++shares.free;
    if (is != was) return dispute(voxel, is, was);
    if (was == Class::occupied && std::abs(a.log_odds - b.log_odds) > bound) ++shares.off;
  });
  sampled.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& b) {
    if (exact.at(voxel).count == 0) dispute(voxel, class_of(b, free_step), Class::untouched);
  });
  return shares;
}

void compare(const Shot& shot, SharesByBound& total) {
  VoxelMap exact(shot.edge_m, {});
  integrate_projective(exact, shot.ping.image(), shot.pose, shot.settings);
  const mapperd::map::Fan fan(shot.ping.image(), shot.settings, exact.rule(), shot.pose);
  for (std::size_t i = 0; i < kBounds.size(); ++i) {
    const Shares one = compared(shot, fan, exact, kBounds[i]);
    if (std::getenv("ORACLE_VERBOSE") != nullptr) print(kBounds[i], one);
    total[i].add(one);
  }
}

// Two hundred voxels of range and more; sanitizer builds see fewer, and one scene.
std::vector<Shot> shots(Aggregation aggregation) {
  std::vector<Shot> all;
  for (int scene = 0; scene < (check::sanitized() ? 1 : 4); ++scene) {
    scenes::Random random(400 + static_cast<std::uint64_t>(scene));
    Ragged want;
    want.half_fan_rad = 0.35;
    want.rows = 400;
    want.beams = scene == 2 ? 40 : 160;
    want.thickness = scene % 2 == 0 ? 1 : 15;  // first returns alone, or speckled echoes
    want.jump = 0.15;
    want.nearer = 0.1;
    Shot shot;
    shot.ping = scenes::ragged_ping(want, random);
    shot.settings.vertical_aperture_rad = 0.2;
    shot.settings.aggregation = aggregation;
    shot.settings.carve_no_return = scene < 2;
    shot.settings.min_range_m = scene == 3 ? 10.0 : 0.5;
    shot.pose = scenes::random_pose(random);
    shot.edge_m = want.max_range_m / (check::sanitized() ? 60 : random.uniform(200, 230));
    all.push_back(std::move(shot));
  }
  return all;
}

void check_bounds(Aggregation aggregation) {
  SharesByBound total;
  for (const Shot& shot : shots(aggregation)) compare(shot, total);
  for (std::size_t i = 0; i < kBounds.size(); ++i) {
    const Shares& s = total[i];
    print(kBounds[i], s);
    CHECK(s.occupied > 200);
    CHECK(s.far == 0);
    // The shares are those of far fields: sanitizer builds only walk the code.
    if (check::sanitized()) continue;
    CHECK(s.off <= 0.01 * s.occupied);
    CHECK(s.disputed + s.edges < 0.015 * s.occupied);
  }
}

TEST_CASE("error_bound holds in 99 of 100 occupied voxels, and classes hardly change") {
  check_bounds(Aggregation::occupied_first);
}

TEST_CASE("error_bound holds for means of both kinds as well") { check_bounds(Aggregation::mean); }

}  // namespace
