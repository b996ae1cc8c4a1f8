#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include "mapperd/alignment/registration.hpp"

namespace mapperd::alignment {
namespace {

// An edge of two walls and a pillar, in voxels of 0.2 m.
std::vector<Vec3> corner() {
  std::vector<Vec3> points;
  for (int z = 0; z < 8; ++z) {
    for (int i = 0; i < 30; ++i) {
      points.push_back({0.2 * i + 0.1, 4.1, 0.2 * z + 0.1});
      points.push_back({6.1, 0.2 * i - 1.9, 0.2 * z + 0.1});
    }
    points.push_back({2.1, 1.1, 0.2 * z + 0.1});
  }
  return points;
}

Submap map_of(const std::vector<Vec3>& occupied, const std::vector<Vec3>& free = {}) {
  return {occupied, free, 0.2, std::vector<double>(occupied.size(), 1.0)};
}

double to_nearest(const std::vector<Vec3>& points, const Vec3& p) {
  double best = kMaxDistanceM;
  for (const Vec3& q : points) best = std::min(best, norm(q - p));
  return best;
}

TEST_CASE("distances of voxels are those of a search of all") {
  const auto points = corner();
  const Submap map = map_of(points);
  std::mt19937 random(3);
  std::uniform_int_distribution<int> x(-10, 40), z(-6, 14);
  std::uniform_real_distribution<double> off(-0.0999, 0.0999);
  for (int k = 0; k < 2000; ++k) {
    const Vec3 centre{0.2 * x(random) + 0.1, 0.2 * x(random) + 0.1, 0.2 * z(random) + 0.1};
    CHECK(std::abs(map.voxel_at(centre).distance_m - to_nearest(points, centre)) < 0.01);
    const Vec3 p = centre + Vec3{off(random), off(random), off(random)};
    const auto nearest = map.nearest(p, 0.8);
    const double true_m = to_nearest(points, p);
    if (true_m < 0.79) {
      REQUIRE(nearest >= 0);
      CHECK(norm(points[static_cast<std::size_t>(nearest)] - p) < true_m + 1e-9);
    } else if (true_m > 0.81) {
      CHECK(nearest == -1);
    }
  }
}

TEST_CASE("the gradient of a distance is its difference") {
  const Submap map = map_of(corner());
  std::mt19937 random(5);
  std::uniform_real_distribution<double> across(3.0, 5.0), along(1.0, 4.0), up(0.3, 1.3);
  for (int k = 0; k < 300; ++k) {
    const Vec3 p{along(random), across(random), up(random)};
    Vec3 slope, other;
    const double d = map.distance_m(p, slope);
    if (d >= kMaxDistanceM) continue;
    const double step = 1e-6;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      Vec3 a = p, b = p;
      a[axis] -= step;
      b[axis] += step;
      const double difference = (map.distance_m(b, other) - map.distance_m(a, other)) / (2 * step);
      CHECK(difference == doctest::Approx(slope[axis]).epsilon(1e-3));
    }
  }
}

TEST_CASE("what was not observed is neither free nor near") {
  const Submap map = map_of(corner(), {{1.1, 0.1, 0.1}});
  CHECK(map.voxel_at({1.15, 0.15, 0.15}).is_free);
  CHECK(!map.voxel_at({1.5, 0.1, 0.1}).is_free);
  CHECK(map.was_observed({1.1, 0.1, 0.1}, 0.2));
  CHECK(!map.was_observed({1.5, 0.1, 0.1}, 0.2));
  CHECK(map.was_observed({2.3, 1.1, 0.1}, 0.25));
  CHECK(!map.was_observed({1e12, 0, 0}, 0.25));
}

TEST_CASE("distributions are means and covariances by weight") {
  const std::vector<Vec3> points{
      {0.1, 0.1, 0.1}, {0.3, 0.3, 0.1}, {0.1, 0.3, 0.5}, {0.3, 0.1, 0.3}, {4.1, 0.1, 0.1}};
  const std::vector<double> weights{1.0, 2.0, 5.0, 3.0, 9.0};
  const Submap map(points, {}, 0.2, weights);
  Vec3 mean;
  for (std::size_t k = 0; k < 4; ++k) mean = mean + (weights[k] / 11.0) * points[k];
  std::array<double, 6> expected{};
  for (std::size_t k = 0; k < 4; ++k) {
    const Vec3 d = points[k] - mean;
    const std::array<double, 6> products{d.x * d.x, d.x * d.y, d.x * d.z,
                                         d.y * d.y, d.y * d.z, d.z * d.z};
    for (std::size_t i = 0; i < 6; ++i) expected[i] += weights[k] / 11.0 * products[i];
  }
  const auto& first = map.distributions()[0];
  CHECK(norm(first.mean_m - mean) < 1e-12);
  const auto& alone = map.distributions()[4];  // its covariance is a voxel's own
  CHECK(alone.mean_m.x == doctest::Approx(4.1));
  for (std::size_t i = 0; i < 6; ++i) {
    CHECK(first.covariance_m2[i] - alone.covariance_m2[i] == doctest::Approx(expected[i]));
  }
}

TEST_CASE("a submap lies on itself, and its information is positive") {
  const Submap map = map_of(corner());
  const auto found = register_submaps(map, map, {0.2, -0.15, 0.05});
  CHECK(found.converged);
  CHECK(std::hypot(found.pose.x, found.pose.y) < 0.01);
  CHECK(std::abs(found.pose.yaw) < 0.005);
  CHECK(found.fit.agreement.matched > 0.95);
  for (std::size_t k = 0; k < 3; ++k) CHECK(found.information[k][k] > 0);
}

}  // namespace
}  // namespace mapperd::alignment
