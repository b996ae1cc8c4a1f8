// Ranges against the crossing of every occupied cell's square.
#include <algorithm>
#include <cmath>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

// Where a ray enters a square of edge 1 with its low corner at (c, r), in cells; 1e9 for never.
double entry(double u, double v, double du, double dv, double c, double r) {
  const double u0 = (c - u) / du, u1 = (c + 1 - u) / du;
  const double v0 = (r - v) / dv, v1 = (r + 1 - v) / dv;
  const double in = std::max(std::min(u0, u1), std::min(v0, v1));
  const double out = std::min(std::max(u0, u1), std::max(v0, v1));
  return out >= std::max(in, 0.0) ? std::max(in, 0.0) : 1e9;
}

double nearest_entry(const OccupancyGrid& grid, double u, double v, double yaw) {
  double best = 1e9;
  for (std::size_t i = 0; i < grid.cells.size(); ++i) {
    if (grid.cells[i] != kOccupied) continue;
    best = std::min(
        best, entry(u, v, std::cos(yaw), std::sin(yaw), static_cast<double>(i % grid.frame.columns),
                    static_cast<double>(i / grid.frame.columns)));
  }
  return best;
}

TEST_CASE("a ray ends where it enters the first occupied cell, to a nanometre") {
  for (const double share : {0.002, 0.02, 0.2}) {
    const OccupancyGrid grid = scattered(60, 80, 17, share);
    const RangeMap map(grid, false, 1);
    for (std::uint32_t i = 0; i < 600; ++i) {
      const Words w = philox({{i, 9, 9, 9}}, 3);
      const double u = 80.0 * uniform_of(w.word[0]);
      const double v = 60.0 * uniform_of(w.word[1]);
      const double yaw = wrapped(2.0 * kPi * uniform_of(w.word[2]));
      const double most = 2.0 + 100.0 * uniform_of(w.word[3]);
      const double found = map.cast({0.5 * u, 0.5 * v, yaw}, 0.5 * most);
      const double entered = nearest_entry(grid, u, v, yaw);
      const double end_u = u + most * std::cos(yaw);
      const double end_v = v + most * std::sin(yaw);
      const bool leaves = end_u < 0 || end_v < 0 || end_u >= 80 || end_v >= 60;
      const double expected = entered <= most ? 0.5 * entered
                              : leaves        ? kNoExpectation
                                              : 0.5 * most;
      CHECK(found == near(expected, 2e-9));
    }
  }
}

TEST_CASE("rays along the axes, from within a wall, from outside, in a map without obstacles") {
  OccupancyGrid grid = open_water(20, 30, 0.5);
  const RangeMap empty(grid, false, 1);
  CHECK(empty.cast({5.0, 5.0, 0.0}, 3.0) == 3.0);
  CHECK(empty.cast({5.0, 5.0, 0.0}, 30.0) == kNoExpectation);
  CHECK(empty.cast({-5.0, 5.0, 0.0}, 30.0) == kNoExpectation);
  grid.cells[10 * 30 + 20] = kOccupied;
  grid.cells[4] = kUnknown;
  const RangeMap map(grid, false, 1);
  CHECK(map.cast({2.25, 5.25, 0.0}, 30.0) == near(7.75, 1e-9));
  CHECK(map.cast({14.0, 5.25, kPi}, 30.0) == near(3.5, 1e-6));
  CHECK(map.cast({10.25, 1.0, 0.5 * kPi}, 30.0) == near(4.0, 1e-6));
  CHECK(map.cast({10.2, 5.2, 1.0}, 30.0) == 0.0);
  CHECK(map.cast({0.25, 0.25, 0.0}, 30.0) == kNoExpectation);
  CHECK(RangeMap(grid, true, 1).cast({0.25, 0.25, 0.0}, 30.0) == near(1.75, 1e-6));
}

TEST_CASE("a ray exactly along an axis goes through a passage of one cell to its end") {
  OccupancyGrid grid = open_water(3, 40, 0.5);
  for (std::size_t c = 0; c < 40; ++c) grid.cells[c] = grid.cells[80 + c] = kOccupied;
  grid.cells[40 + 35] = kOccupied;
  const RangeMap along(grid, false, 1);
  for (const double y : {0.501, 0.75, 0.999}) {
    CHECK(along.cast({1.25, y, 0.0}, 30.0) == near(16.25, 1e-8));
  }
}

// A wedge counts at most 253 columns: the way is longer, to either side and along diagonals.
TEST_CASE("rays cross water wider than a cell can count, and meet the one cell at its end") {
  OccupancyGrid grid = open_water(700, 700, 1.0);
  grid.cells[350 * 700 + 690] = grid.cells[350 * 700 + 5] = kOccupied;
  grid.cells[690 * 700 + 350] = grid.cells[5 * 700 + 350] = kOccupied;
  grid.cells[680 * 700 + 680] = kOccupied;
  const RangeMap map(grid, false, 2);
  for (std::uint32_t i = 0; i < 400; ++i) {
    const Words w = philox({{i, 5, 5, 5}}, 3);
    const double u = 300.0 + 60.0 * uniform_of(w.word[0]);
    const double v = 300.0 + 60.0 * uniform_of(w.word[1]);
    const double yaw = i % 2 == 0 ? std::atan2(350.0 + uniform_of(w.word[2]) - v, 690.0 - u)
                                  : std::atan2(680.0 - v, 680.0 + uniform_of(w.word[2]) - u);
    const double entered = nearest_entry(grid, u, v, yaw);
    const double found = map.cast({u, v, yaw}, 900.0);
    CHECK(found == near(entered < 900.0 ? entered : kNoExpectation, 2e-8));
  }
}

TEST_CASE("rays that run along the cells' edges, all but exactly, end as well") {
  OccupancyGrid grid = open_water(40, 40, 1.0);
  for (std::size_t k = 0; k < 40; ++k) grid.cells[k * 40 + 39] = grid.cells[k * 40] = kOccupied;
  const RangeMap map(grid, false, 1);
  for (int k = -40; k <= 40; ++k) {
    const double yaw = k * 1e-17 * std::pow(10.0, std::abs(k) % 12);
    CHECK(map.cast({20.0, 10.0, yaw}, 100.0) == near(19.0, 1e-6));
    CHECK(map.cast({20.0, 10.0, wrapped(kPi + yaw)}, 100.0) == near(19.0, 1e-6));
  }
}

TEST_CASE("the vector loop's densities are the formula's") {
  const OccupancyGrid grid = basin();
  const RangeMap map(grid, false, 1);
  BeamModel model;
  model.max_range_m = 25.0;
  Beams beams = beams_of(seen_from(map, {0.0, 0.0, 0.3}, 40, 25.0));
  beams.range_m[3] = 25.0;
  beams.range_m[4] = 99.0;
  beams.quality[5] = 0.25;
  beams.sensor_x_m = 0.4;
  Particles particles;
  particles.resize(200);
  draw_about({0.0, 0.0, 0.3}, square_root_of(diagonal(25.0, 25.0, 1.0)), {1, 1}, particles);
  std::vector<double> cubes(200), products(200);
  beam_log_likelihoods(map, beams, model, BeamAggregation::kCubeSum, 1.0, particles, 0, 200,
                       cubes.data());
  beam_log_likelihoods(map, beams, model, BeamAggregation::kProduct, 0.5, particles, 0, 200,
                       products.data());
  for (std::size_t i = 0; i < 200; ++i) {
    const Pose2 p = particles.pose(i);
    double sum = 0.0;
    double logs = 0.0;
    for (std::size_t j = 0; j < beams.size(); ++j) {
      const double expected = map.cast({p.x + 0.4 * std::cos(p.yaw), p.y + 0.4 * std::sin(p.yaw),
                                        wrapped(p.yaw + beams.bearing_rad[j])},
                                       25.0);
      const double expected_density =
          expected < 0.0 ? model.background() : model.density(beams.range_m[j], expected);
      const double q = beams.quality[j];
      const double density = q * expected_density + (1.0 - q) * model.background();
      sum += density * density * density;
      logs += std::log(density);
    }
    CHECK(cubes[i] == near(std::log(sum), 1e-8));
    CHECK(products[i] == near(0.5 * logs, 1e-6));
  }
}

TEST_CASE("the mixture's parts sum to 1 over all readings") {
  BeamModel model;
  model.z_hit = 0.6;
  model.z_short = 0.15;
  model.z_rand = 0.2;
  model.z_max = 0.0;
  model.max_range_m = 20.0;
  for (const double expected : {0.05, 3.0, 19.9, 20.0}) {
    double sum = 0.0;
    const int steps = 200000;
    for (int i = 0; i < steps; ++i)
      sum += model.density(20.0 * (i + 0.5) / steps, expected) * 20.0 / steps;
    CHECK(sum == near(0.95, 1e-4));
  }
}

TEST_CASE("a reading at the largest range, and beyond it, is z_max") {
  BeamModel model;
  model.max_range_m = 20.0;
  model.z_max = 0.07;
  CHECK(model.density(20.0, 5.0) == near(0.07, 1e-12));
  CHECK(model.density(99.0, 5.0) == near(0.07, 1e-12));
  const double hit = 2.0 * 0.5 / (0.2 * std::sqrt(2.0 * kPi));  // half of the Gaussian is cut off
  CHECK(model.density(20.0, 20.0) == near(hit + 0.07, 1e-9));
  CHECK(model.density(99.0, 20.0) == model.density(20.0, 20.0));
  CHECK(model.density(5.0, 5.0 + 1e-8) == near(model.density(5.0, 5.0), 1e-9));  // not a short one
}

}  // namespace
