// Estimates against the formulas, far from the origin and in degenerate clouds.
#include <cmath>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

double smallest_pivot(const Matrix3& c) {
  const double first = c[0][0];
  const double second = c[1][1] - c[0][1] * c[0][1] / first;
  const double l = c[1][2] - c[0][1] * c[0][2] / first;
  return std::min({first, second, c[2][2] - c[0][2] * c[0][2] / first - l * l / second});
}

TEST_CASE("a cloud's moments are found again, also at 1e7 m from the origin") {
  const Matrix3 truth{{{0.5, 0.1, 0.02}, {0.1, 0.3, -0.01}, {0.02, -0.01, 0.01}}};
  for (const double far : {0.0, 1e7}) {
    Particles particles;
    particles.resize(100000);
    draw_about({far, -far, kPi - 0.01}, square_root_of(truth), {4, 4}, particles);
    const Estimate e = estimate_of(particles, std::vector<double>(100000, 1e-5));
    CHECK(e.mean.x == near(far, 0.01));
    CHECK(wrapped(e.mean.yaw - (kPi - 0.01)) == near(0.0, 0.002));
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) CHECK(e.covariance[i][j] == near(truth[i][j], 0.01));
    }
    CHECK(e.covariance[0][2] == near(0.02, 0.001));
  }
}

TEST_CASE("the matrix is one of covariance even where place and heading go together") {
  for (const double width : {0.1, 1.0, 2.0, 3.0}) {
    Particles particles;
    particles.resize(51);
    for (std::size_t i = 0; i < 51; ++i) {
      const double t = width * (static_cast<double>(i) / 25.0 - 1.0);
      particles.set(i, {t, 0.1 * t * t, t});
    }
    const Estimate e = estimate_of(particles, std::vector<double>(51, 1.0 / 51.0));
    CHECK(smallest_pivot(e.covariance) > -1e-12);
    CHECK(e.covariance[0][2] > 0.0);
  }
}

TEST_CASE("the matrix is one of covariance where a few particles head the other way") {
  Particles particles;
  particles.resize(100);
  for (std::size_t i = 0; i < 100; ++i) {
    const bool other = i < 5;
    particles.set(i, {other ? 1.0 : 0.0, 0.001 * static_cast<double>(i % 7), other ? 3.1 : 0.0});
  }
  const Estimate e = estimate_of(particles, std::vector<double>(100, 0.01));
  CHECK((smallest_pivot(e.covariance) > -1e-12 && e.covariance[0][2] > 0.0));
}

TEST_CASE("a cloud on a slanting line has finite numbers and a correlation of 1 at the most") {
  for (int scale = 1; scale < 60; ++scale) {
    Particles particles;
    particles.resize(4);
    for (std::size_t i = 0; i < 4; ++i) {
      const double t = scale * static_cast<double>(i);
      particles.set(i, {t, t, 0.1 * static_cast<double>(i)});
    }
    const Estimate e = estimate_of(particles, std::vector<double>(4, 0.25));
    for (const auto& row : e.covariance) {
      for (const double value : row) CHECK(std::isfinite(value));
    }
    // To the last bit: the root of 1 minus the squared correlation is a number.
    const double most = std::sqrt(e.covariance[0][0]) * std::sqrt(e.covariance[1][1]);
    CHECK(std::abs(e.covariance[0][1]) <= most);
  }
}

TEST_CASE("one particle, all weight on one, equal ones and opposite headings") {
  Particles two;
  two.resize(2);
  two.set(0, {1, 2, 0.5});
  two.set(1, {5, 5, 0.5 + kPi});
  const Estimate one = estimate_of(two, {1.0, 0.0});
  CHECK((!one.spread_known && one.covariance[0][0] == kMinVariance));
  CHECK((one.covariance[2][2] == kMinVariance && one.covariance[0][1] == 0.0));
  const Estimate opposite = estimate_of(two, {0.5, 0.5});
  CHECK((!opposite.heading_known && opposite.mean.yaw == 0.0));
  CHECK((std::isinf(opposite.covariance[2][2]) && opposite.covariance[0][2] == 0.0));
  two.set(1, {1, 2, 0.5});
  const Estimate equal = estimate_of(two, {0.5, 0.5});
  CHECK((equal.spread_known && equal.covariance[1][1] == kMinVariance));
  CHECK(estimate_of({}, {}).particles == 0);
}

TEST_CASE("headings that cancel do not go with places, wherever those are") {
  Particles square;
  square.resize(4);
  square.set(0, {0, 0, 0.0});
  square.set(1, {1, 0, 0.5 * kPi});
  square.set(2, {0, 1, kPi});
  square.set(3, {1, 1, -0.5 * kPi});
  const Estimate e = estimate_of(square, std::vector<double>(4, 0.25));
  CHECK((!e.heading_known && std::isinf(e.covariance[2][2])));
  CHECK((e.covariance[0][2] == 0.0 && e.covariance[2][0] == 0.0));
  CHECK((e.covariance[1][2] == 0.0 && e.covariance[2][1] == 0.0));
}

TEST_CASE("square roots: correlated, of lower rank, nothing; and what is refused") {
  for (const Matrix3& c :
       {Matrix3{{{0.5, 0.1, 0.02}, {0.1, 0.3, -0.01}, {0.02, -0.01, 0.01}}},
        Matrix3{{{1, 1, 1}, {1, 1, 1}, {1, 1, 1}}}, Matrix3{}, diagonal(1.0, -1e-12, 0.0)}) {
    const Matrix3 r = square_root_of(c);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        CHECK(r[i][0] * r[j][0] + r[i][1] * r[j][1] + r[i][2] * r[j][2] == near(c[i][j], 1e-9));
      }
    }
  }
  CHECK_THROWS_AS(square_root_of(diagonal(1.0, -1e-6, 0.0)), std::invalid_argument);
  CHECK_THROWS_AS(square_root_of(diagonal(-1.0, -1.0, -1.0)), std::invalid_argument);
  CHECK_THROWS_AS(square_root_of(diagonal(std::nan(""), 1.0, 1.0)), std::invalid_argument);
  CHECK_THROWS_AS(square_root_of({{{1, 0.1, 0}, {0, 1, 0}, {0, 0, 1}}}), std::invalid_argument);
}

}  // namespace
