// Weighting against the formulas, particle by particle.
#include <cmath>
#include <limits>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

Particles cloud(std::size_t count) {
  Particles particles;
  particles.resize(count);
  draw_about({-3.0, 2.0, 0.4},
             square_root_of({{{9.0, 1.0, 0.2}, {1.0, 9.0, 0.1}, {0.2, 0.1, 2.0}}}), {5, 1},
             particles);
  return particles;
}

double value_at(const LikelihoodField& field, const Pose2& p, double x, double y) {
  const GridFrame& f = field.frame();
  const double mx = p.x + std::cos(p.yaw) * x - std::sin(p.yaw) * y - f.origin.x;
  const double my = p.y + std::sin(p.yaw) * x + std::cos(p.yaw) * y - f.origin.y;
  const double u = (std::cos(f.origin.yaw) * mx + std::sin(f.origin.yaw) * my) / f.resolution_m;
  const double v = (std::cos(f.origin.yaw) * my - std::sin(f.origin.yaw) * mx) / f.resolution_m;
  const bool in =
      u >= 0 && v >= 0 && u < static_cast<double>(f.columns) && v < static_cast<double>(f.rows);
  return in ? static_cast<double>(
                  field.at(0, static_cast<std::size_t>(v), static_cast<std::size_t>(u)))
            : field.background();
}

void compare(const LikelihoodField& field, const Endpoints& ends) {
  const Particles particles = cloud(333);
  std::vector<double> cubes(333);
  std::vector<double> products(333);
  field_log_likelihoods(field, ends, BeamAggregation::kCubeSum, 1.0, particles, 0, 333,
                        cubes.data());
  field_log_likelihoods(field, ends, BeamAggregation::kProduct, 0.3, particles, 0, 333,
                        products.data());
  for (std::size_t i = 0; i < 333; ++i) {
    double sum = 1.0;
    double logs = 0.0;
    for (std::size_t j = 0; j < ends.beams(); ++j) {
      const double q = ends.quality[j];
      const double p = q * value_at(field, particles.pose(i), ends.x_m[j], ends.y_m[j]) +
                       (1.0 - q) * field.background();
      sum += p * p * p;
      logs += std::log(p);
    }
    CHECK(cubes[i] == near(std::log(sum), 1e-12 * std::max(1.0, std::log(sum))));
    CHECK(products[i] == near(0.3 * logs, 1e-11));
  }
}

TEST_CASE("weights are the formulas' on plain and turned maps, with any quality") {
  OccupancyGrid grid = basin();
  const RangeMap ranges(grid, false, 1);
  Endpoints ends = seen_from(ranges, {-3.0, 2.0, 0.4}, 61, 40.0);
  compare(LikelihoodField(grid, {}, {}, 1), ends);
  for (std::size_t j = 0; j < ends.beams(); ++j)
    ends.quality[j] = 0.1 * static_cast<double>(j % 11);
  grid.frame.origin.yaw = 0.7;
  compare(LikelihoodField(grid, {}, {}, 2), ends);
}

TEST_CASE("a thousand hopeless beams leave a finite log-likelihood") {
  HitModel model;
  model.z_rand = 0.0;
  const LikelihoodField field(basin(), model, {}, 1);
  Endpoints ends;
  ends.x_m.assign(1000, 1e5);
  ends.y_m.assign(1000, -1e5);
  ends.quality.assign(1000, 1.0);
  const Particles particles = cloud(3);
  double logs[3];
  field_log_likelihoods(field, ends, BeamAggregation::kProduct, 1.0, particles, 0, 3, logs);
  const double expected = 1000.0 * std::log(field.background());
  for (const double log : logs) CHECK(log == near(expected, 1e-9 * std::abs(expected)));
}

TEST_CASE("of a fan of elevations the likeliest counts, at its height") {
  // One obstacle voxel at (2, 1, 1) of 4 x 3 x 3 voxels of 1 m whose first centre is (0.5, 0.5,
  // 0.5).
  std::vector<float> distances;
  for (int x = 0; x < 4; ++x) {
    for (int y = 0; y < 3; ++y) {
      for (int z = 0; z < 3; ++z)
        distances.push_back(static_cast<float>(std::hypot(x - 2, y - 1, z - 1)));
    }
  }
  const HitModel model;
  const LikelihoodField field(distances, {4, 3, 3}, {0.5, 0.5, 0.5}, 1.0, model);
  Particles one;
  one.resize(1);
  one.set(0, {0.5, 1.5, 0.0});
  const auto logs = [&](const Endpoints& ends) {
    double log = 0.0;
    field_log_likelihoods(field, ends, BeamAggregation::kProduct, 1.0, one, 0, 1, &log);
    return log;
  };
  const Endpoints fan{3, {2.0, 2.0, 2.0}, {0.0, 0.0, 0.0}, {0.5, 1.5, 2.5}, {1.0}};
  CHECK(logs(fan) == near(std::log(model.density(0.0)), 1e-6));
  const Endpoints low{1, {2.0}, {0.0}, {0.5}, {1.0}};
  CHECK(logs(low) == near(std::log(model.density(1.0)), 1e-6));
  const Endpoints above{1, {2.0}, {0.0}, {3.5}, {1.0}};
  CHECK(logs(above) == near(std::log(model.density(99.0)), 1e-6));
  CHECK_THROWS_AS(logs({1, {2.0}, {0.0}, {}, {1.0}}), std::invalid_argument);
}

TEST_CASE("poses that are not numbers count as off the map") {
  const LikelihoodField field(basin(), {}, {}, 1);
  Particles particles;
  particles.resize(3);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  particles.set(0, {nan, 0.0, 0.0});
  particles.set(1, {1e300, -1e300, 0.0});
  particles.set(2, {0.0, 0.0, nan});
  const Endpoints ends{1, {1.0}, {1.0}, {}, {1.0}};
  double logs[3];
  field_log_likelihoods(field, ends, BeamAggregation::kProduct, 1.0, particles, 0, 3, logs);
  for (const double log : logs) CHECK(log == near(std::log(field.background()), 1e-9));
}

}  // namespace
