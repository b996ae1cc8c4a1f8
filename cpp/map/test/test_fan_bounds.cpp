// What the fan says of a cube beforehand: how far it reaches, and its verdict, without any map.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/block_evidence.hpp"
#include "mapperd/map/cube_cut.hpp"

namespace {

using mapperd::map::Fan;
using mapperd::Vec3;
using oracle::Parts;

int turns(int in_release) {
  return std::getenv("MAPPERD_ORACLE_SCENES") == nullptr ? in_release : in_release / 20;
}

scenes::Ping wide_ping() { return scenes::empty_ping(10, 64, 1.5, 100); }

Vec3 random_place(scenes::Random& random, double reach_m, double elevation_rad) {
  const double range = reach_m * random.uniform(0.02, 1);
  return mapperd::map::fan_point(range, random.uniform(-1.57, 1.57),
                            random.uniform(-elevation_rad, elevation_rad));
}

// Points of a cube: its corners, what is nearest to the sonar, and others of its surface.
std::array<Vec3, 24> points_of(const Vec3& centre, double edge_m, scenes::Random& random) {
  std::array<Vec3, 24> points;
  const double half = edge_m / 2;
  for (std::size_t i = 0; i < points.size(); ++i) {
    std::array<double, 3> shift{i & 1 ? half : -half, i & 2 ? half : -half, i & 4 ? half : -half};
    if (i == 8) {
      shift = {std::clamp(-centre.x, -half, half), std::clamp(-centre.y, -half, half),
               std::clamp(-centre.z, -half, half)};
    } else if (i > 8) {  // on an edge or a face
      shift[i % 3] = random.uniform(-half, half);
      if (i > 16) shift[(i + 1) % 3] = random.uniform(-half, half);
    }
    points[i] = centre + Vec3{shift[0], shift[1], shift[2]};
  }
  return points;
}

void check_reach(const Fan& fan, const Vec3& centre, const Fan::Extent& extent, double edge_m,
                 scenes::Random& random) {
  const double hair = 1e-9;
  const Fan::Place at = fan.place_of(centre);
  const Vec3 in_sonar = fan.to_sonar(centre);
  const bool one_side = std::abs(in_sonar.z) > 0.87 * edge_m;  // of the fan's middle plane
  for (const Vec3& point : points_of(centre, edge_m, random)) {
    const Fan::Place p = fan.place_of(point);
    CHECK(p.range >= at.range - extent.inward - hair);
    CHECK(p.range <= at.range + extent.outward + hair);
    CHECK(std::abs(p.horizontal - at.horizontal) <= extent.forward + hair);
    CHECK(std::abs(p.sine - at.sine) <= extent.spread + hair);
    CHECK(std::abs(p.inside_sides - at.inside_sides) <= extent.level + hair);
    if (one_side) CHECK(std::abs(p.inside_aperture - at.inside_aperture) <= extent.aperture + hair);
  }
}

TEST_CASE("a fan of half a turn ends at 90 degrees, and a wide one not beyond") {
  const double half_pi = std::asin(1.0);
  for (const double last : {half_pi, 1.3}) {
    const double bearings[] = {-last, 0.0, last};
    const auto edges = mapperd::map::beam_edges(bearings, 3);
    CHECK(edges.front() == -half_pi && edges.back() == half_pi);
    CHECK_NEAR(edges[1], -std::asin(std::sin(last) / 2), 1e-15);
  }
}

TEST_CASE("a cube reaches no farther than its extent says, in any direction") {
  scenes::Random random(601);
  const scenes::Ping ping = wide_ping();
  for (int i = 0; i < turns(400); ++i) {
    mapperd::map::FanSettings settings;
    settings.vertical_aperture_rad = random.uniform(0.05, 0.6);
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random));
    for (int k = 0; k < 50; ++k) {
      const Vec3 centre = fan.to_map(random_place(random, 100, 0.4));
      const double edge_m = mapperd::norm(centre) * random.uniform(0.003, 0.3);
      check_reach(fan, centre, fan.extent_of(fan.to_sonar(centre), edge_m), edge_m, random);
    }
  }
}

TEST_CASE("every voxel of a cell reaches no farther than the cell's extent says") {
  scenes::Random random(602);
  const scenes::Ping ping = wide_ping();
  for (int i = 0; i < turns(400); ++i) {
    mapperd::map::FanSettings settings;
    settings.vertical_aperture_rad = random.uniform(0.05, 0.6);
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random));
    for (int k = 0; k < 10; ++k) {
      // Half of the cells around the middle plane, where they meet both cones.
      const Vec3 middle = fan.to_map(random_place(random, 100, k % 2 == 0 ? 0.02 : 1.5));
      const double edge_m = mapperd::norm(middle) / random.uniform(20, 300);
      const Fan::Extent extent = fan.extent_in_cell(fan.to_sonar(middle), edge_m, 4);
      for (int v = 0; v < 8; ++v) {
        const auto shift = [&] { return (random.integer(0, 1) * 3 - 1.5) * edge_m; };
        check_reach(fan, middle + Vec3{shift(), shift(), shift()}, extent, edge_m, random);
      }
    }
  }
}

TEST_CASE("a voxel's nearest and farthest slices hold a negligible part of it, and hardly less") {
  scenes::Random random(603);
  const scenes::Ping ping = wide_ping();
  double most = 0.0;
  for (int i = 0; i < turns(20000); ++i) {
    mapperd::Transform pose = scenes::random_pose(random);
    if (i % 4 == 0) pose = scenes::rotation_zyx(1e-3, 1e-3, 1e-3);
    const Fan fan(ping.image(), {}, mapperd::map::IwloRule{{}}, pose);
    const double range = std::pow(10, random.uniform(2, 4));
    const double bearing = i % 8 == 0 ? 0.0 : random.uniform(-1.5, 1.5);
    const Vec3 in_sonar = mapperd::map::fan_point(range, bearing, i % 8 == 0 ? 0.0 : 0.15);
    const double edge_m = 1.0;
    const Fan::Extent extent = fan.extent_in_cell(in_sonar, edge_m, 4);
    // So far away the sphere through a voxel is a plane.
    const double part = mapperd::map::part_beyond((1 / range) * fan.to_map(in_sonar),
                                             (extent.cap - extent.inward) / edge_m);
    CHECK(extent.cap >= 0 && part < 0.01 + 1e-9);
    most = std::max(most, part);
  }
  std::printf("  at most %.2f %%\n", 100 * most);
  CHECK(most > 0.009);
}

TEST_CASE("a negligible slice is one in every direction that a cell's voxels are seen in") {
  scenes::Random random(604);
  const scenes::Ping ping = wide_ping();
  for (int i = 0; i < turns(4000); ++i) {
    mapperd::Transform pose = scenes::random_pose(random);
    if (i % 2 == 0) pose = {};
    const Fan fan(ping.image(), {}, mapperd::map::IwloRule{{}}, pose);
    const bool along = i % 4 == 0;  // an axis of the map, so that widths are less than the turn
    const Vec3 in_sonar =
        mapperd::map::fan_point(random.uniform(16, 60), along ? 0.0 : random.uniform(-1.5, 1.5), 0.0);
    const double cap = fan.extent_in_cell(in_sonar, 1.0, 4).cap;
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3 shift{corner & 1 ? 1.5 : -1.5, corner & 2 ? 1.5 : -1.5, corner & 4 ? 1.5 : -1.5};
      const Vec3 place = fan.to_map(in_sonar) + shift;
      const Vec3 n = (1 / mapperd::norm(place)) * place;
      const double reach = 0.5 * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z));
      CHECK(mapperd::map::part_beyond(n, cap - reach) < 0.01 + 1e-9);
    }
  }
}

struct Seen {
  int mostly = 0;
  int less = 0;
  int in_slices = 0;  // settled though a return lies in the voxel's rows
};

// A verdict, if there is one, against the closed form.
void check_verdict(const Fan& fan, const Vec3& centre, double edge_m, const Fan::Verdict& verdict,
                   Seen& seen) {
  using Content = Fan::Content;
  if (verdict.content == Content::undecided) return;
  const Parts own = scenes::parts_on_its_own(fan, centre, edge_m);
  const double hair = 1e-6 + (own.free < 1 ? 2e-4 * (verdict.where.cut_by_aperture ? 1 : 0) : 0.0);
  CHECK(own.occupied < mapperd::map::kOccupiedPart + hair);
  if (own.occupied > 0) ++seen.in_slices;
  if (verdict.content == Content::nothing) CHECK(own.free <= hair);
  if (verdict.content == Content::all_free) CHECK(own.free >= 1 - hair);
  if (verdict.content == Content::less_free) CHECK(own.free <= mapperd::map::kFreePart + hair);
  if (verdict.content == Content::mostly_free) CHECK(own.free > mapperd::map::kFreePart - hair);
  seen.mostly += verdict.content == Content::mostly_free ? 1 : 0;
  seen.less += verdict.content == Content::less_free ? 1 : 0;
}

// Half of the beams silent, the others with one row at about the same range: voxels there are cut
// by planes between beams and have that row in their nearest or farthest slices.
TEST_CASE("verdicts on voxels with a return in their outermost slices") {
  Seen seen;
  for (std::uint64_t scene = 0; scene < 12; ++scene) {
    scenes::Random random(610 + scene);
    scenes::Ragged want;
    want.jump = scene % 3 == 0 ? 0.004 : 0.0;
    want.silent = 0.5;
    want.rows = 2000;
    want.beams = scene % 2 == 0 ? 64 : 200;
    const scenes::Ping ping = scenes::ragged_ping(want, random);
    mapperd::map::FanSettings settings;
    settings.carve_no_return = scene % 4 == 1;
    mapperd::Transform pose = scenes::random_pose(random);
    if (scene % 4 == 0) pose = scenes::rotation_zyx(0.01, 0.01, 0.01);  // slices as thin as slabs
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, pose);
    const double edge_m = want.max_range_m / random.uniform(100, 300);
    const scenes::Borders borders(ping, settings, edge_m);
    for (int i = 0; i < turns(6000); ++i) {
      const Vec3 centre = fan.to_map(borders.corner(random));
      if (mapperd::norm(centre) < 20 * edge_m) continue;
      const Fan::Extent extent = fan.extent_in_cell(fan.to_sonar(centre), edge_m, 4);
      const Fan::Verdict verdict = fan.verdict(centre, fan.place_of(centre), extent);
      check_verdict(fan, centre, edge_m, verdict, seen);
    }
  }
  std::printf("  %d mostly free, %d less, %d with returns in their slices\n", seen.mostly,
              seen.less, seen.in_slices);
  CHECK(seen.mostly > turns(1000) && seen.less > turns(1000) && seen.in_slices > turns(1000));
}

// Silent beams that count as free to the end of the range: the sphere there halves voxels.
TEST_CASE("verdicts on voxels at the end of the range") {
  Seen seen;
  scenes::Random random(620);
  const scenes::Ping ping = scenes::empty_ping(100, 40, 1.0, 100);
  mapperd::map::FanSettings settings;
  settings.carve_no_return = true;
  for (int i = 0; i < turns(100); ++i) {
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random));
    for (int k = 0; k < 20; ++k) {
      const double edge_m = 100 / random.uniform(25, 100);
      const double range = 100 + random.uniform(-0.03, 0.03) * edge_m;
      const Vec3 in_sonar = mapperd::map::fan_point(range, random.uniform(-0.8, 0.8), 0.05);
      const Vec3 centre = fan.to_map(in_sonar);
      const Fan::Extent extent = fan.extent_in_cell(in_sonar, edge_m, 4);
      check_verdict(fan, centre, edge_m, fan.verdict(centre, fan.place_of(centre), extent), seen);
    }
  }
  CHECK(seen.mostly > turns(500) && seen.less > turns(500));
}

TEST_CASE("verdicts on cubes of any size, beside the sonar and far from it") {
  Seen seen;
  for (std::uint64_t scene = 0; scene < 12; ++scene) {
    scenes::Random random(630 + scene);
    scenes::Ragged want;
    want.half_fan_rad = random.uniform(0.05, 1.5);
    want.max_range_m = 1.0;
    want.silent = 0.3;
    const scenes::Ping ping = scenes::ragged_ping(want, random);
    mapperd::map::FanSettings settings;
    settings.vertical_aperture_rad = scene % 2 == 0 ? random.uniform(0.01, 0.1) : 0.4;
    settings.carve_no_return = scene % 3 == 0;
    settings.min_range_m = scene % 4 == 0 ? 0.0 : 0.05;
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random));
    for (int i = 0; i < turns(5000); ++i) {
      const double edge_m = 0.1 * std::pow(10, random.uniform(-1.3, 0));
      const scenes::Borders borders(ping, settings, edge_m);
      const Vec3 centre = fan.to_map(borders.point(random));
      check_verdict(fan, centre, edge_m, fan.verdict(centre, edge_m), seen);
    }
  }
  std::printf("  %d mostly free, %d less\n", seen.mostly, seen.less);
  CHECK(seen.mostly > turns(100) && seen.less > turns(100));
}

}  // namespace
