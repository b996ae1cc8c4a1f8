#include <cmath>
#include <vector>

#include "mapperd/acoustics/sound_layers.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr double kGradient = 2.0;  // m/s per metre of depth
const acoustics::SoundLayers kSlope{{0.0, 100.0}, {1450.0, 1450.0 + 100.0 * kGradient}};

TEST_CASE("speeds are linear between depths and constant beyond") {
  const acoustics::SoundLayers layers{{10.0, 20.0, 40.0}, {1500.0, 1480.0, 1490.0}};
  double speed = 0.0;
  CHECK((acoustics::speed_gradient(layers, -5.0, speed) == 0.0 && speed == 1500.0));
  CHECK((acoustics::speed_gradient(layers, 15.0, speed) == near(2.0, 1e-12)));
  CHECK(speed == near(1490.0, 1e-9));
  CHECK((acoustics::speed_gradient(layers, 30.0, speed) == near(-0.5, 1e-12)));
  CHECK(speed == near(1485.0, 1e-9));
  CHECK((acoustics::speed_gradient(layers, 90.0, speed) == 0.0 && speed == 1490.0));
}

// In a constant gradient g, a ray that leaves level at speed c is a circle of radius c / g.
TEST_CASE("a ray in a constant gradient is an arc, and its time that of the arc") {
  constexpr std::size_t kSteps = 400;
  constexpr double kStep = 0.25;
  const double origin[3] = {3.0, -2.0, -50.0};
  double direction[3] = {0.6, 0.8, 0.0};
  std::vector<double> corners(3 * (kSteps + 1)), ranges(kSteps + 1);
  acoustics::follow_rays(kSlope, 1, origin, direction, kStep, kSteps, 1500.0, corners.data(),
                         ranges.data());
  const double radius = 1550.0 / kGradient;
  const double angle = kStep * kSteps / radius;
  const double* end = corners.data() + 3 * kSteps;
  CHECK(std::hypot(end[0] - 3.0, end[1] + 2.0) == near(radius * std::sin(angle), 1e-4));
  CHECK(end[2] + 50.0 == near(radius * (1.0 - std::cos(angle)), 1e-3));
  CHECK((end[0] - 3.0) / (end[1] + 2.0) == near(0.75, 1e-9));
  // dt = ds / c and c falls with the cosine: t = ln tan(pi/4 + angle/2) / g.
  const double time_s = std::log(std::tan(std::atan(1.0) + angle / 2.0)) / kGradient;
  CHECK(ranges[kSteps] == near(1500.0 * time_s, 1e-3));
  CHECK(std::hypot(direction[0], direction[1], direction[2]) == near(1.0, 1e-12));
}

TEST_CASE("a ray straight up stays so") {
  const double point[3] = {0.0, 0.0, -20.0};
  double direction[3] = {0.0, 0.0, 1.0};
  double speed = 0.0;
  acoustics::turn_rays(kSlope, 1, point, direction, 2.0, 2.0, &speed, 1);
  CHECK((direction[0] == 0.0 && direction[1] == 0.0 && direction[2] == near(1.0, 1e-9)));
  CHECK(speed == near(1488.0, 1e-9));
}

TEST_CASE("rays turn alike on any number of threads") {
  constexpr std::size_t kCount = 20000;
  std::vector<double> points(3 * kCount), alone(3 * kCount), speeds(kCount);
  for (std::size_t i = 0; i < kCount; ++i) {
    const double angle = 1e-4 * static_cast<double>(i);
    points[3 * i + 2] = -0.004 * static_cast<double>(i);
    alone[3 * i] = std::cos(angle);
    alone[3 * i + 2] = std::sin(angle);
  }
  std::vector<double> shared = alone;
  acoustics::turn_rays(kSlope, kCount, points.data(), alone.data(), 1.0, 1.0, speeds.data(), 1);
  acoustics::turn_rays(kSlope, kCount, points.data(), shared.data(), 1.0, 1.0, speeds.data(), 3);
  CHECK(alone == shared);
}

}  // namespace
