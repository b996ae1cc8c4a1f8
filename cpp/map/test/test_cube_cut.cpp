// The part of a cube beyond a plane, against closed forms of simple cuts and against counting.
#include <algorithm>
#include <array>
#include <cmath>

#include "check.hpp"
#include "mapperd/map/cube_cut.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::part_beyond;
using mapperd::Vec3;

Vec3 random_direction(scenes::Random& random) {
  const double up = random.uniform(-1, 1);
  const double turn = random.uniform(-3.2, 3.2);
  const double level = std::sqrt(1 - up * up);
  return {level * std::cos(turn), level * std::sin(turn), up};
}

double reach(const Vec3& n) { return 0.5 * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z)); }

// Lines along x, 400 x 400 of them: along x exact, across the midpoint rule.
double counted(const Vec3& n, double offset) {
  constexpr int kLines = 400;
  double sum = 0.0;
  for (int i = 0; i < kLines; ++i) {
    for (int j = 0; j < kLines; ++j) {
      const double y = (i + 0.5) / kLines - 0.5;
      const double z = (j + 0.5) / kLines - 0.5;
      const double crossing = -(offset + n.y * y + n.z * z) / n.x;
      const double below = std::clamp(crossing, -0.5, 0.5) + 0.5;
      sum += n.x > 0 ? 1 - below : below;
    }
  }
  return sum / (kLines * kLines);
}

TEST_CASE("a cube cut parallel to its faces") {
  for (const double length : {1.0, 0.25, 7.0}) {
    for (double d = -0.7; d <= 0.7; d += 0.05) {
      const double expected = std::clamp(0.5 + d, 0.0, 1.0);
      for (const double sign : {-length, length}) {
        CHECK_NEAR(part_beyond({sign, 0, 0}, d * length), expected, 1e-12);
        CHECK_NEAR(part_beyond({0, sign, 0}, d * length), expected, 1e-12);
        CHECK_NEAR(part_beyond({0, 0, sign}, d * length), expected, 1e-12);
      }
    }
  }
}

TEST_CASE("a cube cut parallel to one of its edges") {
  // Beyond a line through a unit square: a triangle, a trapezium, or all but a triangle.
  const auto square = [](double a, double b, double d) {
    const double low = std::min(std::abs(a), std::abs(b));
    const double high = std::max(std::abs(a), std::abs(b));
    const double depth = 0.5 * (low + high) - std::abs(d);
    double part = 0.0;
    if (depth > low) part = (depth - low / 2) / high;
    if (depth > 0 && depth <= low) part = depth * depth / (2 * low * high);
    return d > 0 ? 1 - part : part;
  };
  scenes::Random random(41);
  for (int i = 0; i < 3000; ++i) {
    const double a = random.uniform(-1, 1);
    const double b = random.uniform(-1, 1);
    const double d = random.uniform(-0.6, 0.6) * (std::abs(a) + std::abs(b));
    const double expected = square(a, b, d);
    CHECK_NEAR(part_beyond({a, b, 0}, d), expected, 1e-9);
    CHECK_NEAR(part_beyond({0, a, b}, d), expected, 1e-9);
    CHECK_NEAR(part_beyond({b, 0, a}, d), expected, 1e-9);
  }
}

TEST_CASE("a corner cut off a cube is a tetrahedron") {
  scenes::Random random(42);
  for (int i = 0; i < 3000; ++i) {
    const Vec3 n{random.uniform(0.05, 1), random.uniform(-1, -0.05), random.uniform(0.05, 1)};
    const double depth = random.uniform(0, 1) * std::min({n.x, -n.y, n.z});
    const double expected = depth * depth * depth / (6 * n.x * -n.y * n.z);
    CHECK_NEAR(part_beyond(n, depth - reach(n)), expected, 1e-12);
    CHECK_NEAR(part_beyond(n, reach(n) - depth), 1 - expected, 1e-12);
  }
}

TEST_CASE("any cut, against counting") {
  scenes::Random random(43);
  for (int i = 0; i < 60; ++i) {
    Vec3 n = random_direction(random);
    if (std::abs(n.x) < 0.3) n.x = std::copysign(0.3, n.x);
    const double offset = random.uniform(-1.05, 1.05) * reach(n);
    CHECK_NEAR(part_beyond(n, offset), counted(n, offset), 2e-5);
  }
}

TEST_CASE("cuts on either side of the centre add up to one, and more offset leaves more") {
  scenes::Random random(44);
  for (int i = 0; i < 300; ++i) {
    const Vec3 n = random_direction(random);
    double before = 0.0;
    for (int step = -60; step <= 60; ++step) {
      const double offset = reach(n) * step / 55.0;
      const double part = part_beyond(n, offset);
      CHECK(part >= before - 1e-12 && part <= 1.0);
      CHECK_NEAR(part_beyond(n, -offset), 1 - part, 1e-12);
      CHECK_NEAR(part_beyond(-1.0 * n, offset), part, 1e-12);
      before = part;
    }
    CHECK_NEAR(part_beyond(n, 0.0), 0.5, 1e-9);
    CHECK(part_beyond(n, -1.001 * reach(n)) == 0.0 && part_beyond(n, 1.001 * reach(n)) == 1.0);
  }
}

TEST_CASE("normals almost along a face or an axis lose no digits") {
  // The part changes by no more than the plane moves over the cube when a component is left out.
  scenes::Random random(45);
  for (const double tiny : {1e-3, 1e-4, 1.1e-5, 9e-6, 1e-6, 1e-7, 1e-9}) {
    for (int i = 0; i < 300; ++i) {
      const double a = random.uniform(0.3, 1);
      const double b = random.uniform(0.3, 1);
      const double d = random.uniform(-0.45, 0.45) * (a + b);
      // To first order the two halves of the tilt cancel. Two small components, and a sum of cubes
      // over their product, cost digits, at worst just above where they begin to count as none.
      const double second_order = 2 * tiny * tiny + 1e-6;
      CHECK_NEAR(part_beyond({a, tiny, b}, d), part_beyond({a, 0, b}, d), second_order);
      const double level = random.uniform(-0.4, 0.4) * a;
      CHECK_NEAR(part_beyond({tiny, a, -tiny}, level), 0.5 + level / a, second_order);
      CHECK_NEAR(part_beyond({0, tiny, a}, level), 0.5 + level / a, second_order);
      CHECK_NEAR(part_beyond({1e-3 * tiny, tiny, a}, level), 0.5 + level / a, second_order);
      const Vec3 flat{a, tiny, -tiny};
      const double edge = random.uniform(-1, 1) * tiny + 0.5 * a;
      for (const double part : {part_beyond(flat, edge), part_beyond(flat, -edge)}) {
        CHECK(part >= 0.0 && part <= 1.0);
      }
    }
  }
}

}  // namespace
