// Motion models against their formulas: moments of many particles.
#include <algorithm>
#include <cmath>
#include <limits>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

struct Moments {
  double mean[3];
  double sigma[3];
};

// Of the step in each particle's own frame before it: ahead, to port, turn.
Moments moments_of(const MotionDraws& draws, const Pose2& start, const MotionFloor& floor = {}) {
  constexpr std::size_t kCount = 200000;
  Particles particles;
  particles.resize(kCount);
  for (std::size_t i = 0; i < kCount; ++i) particles.set(i, start);
  move(particles, 0, kCount, draws, floor, {11, 4});
  Moments m{};
  double squares[3] = {};
  for (std::size_t i = 0; i < kCount; ++i) {
    const double dx = particles.x[i] - start.x;
    const double dy = particles.y[i] - start.y;
    const double step[] = {std::cos(start.yaw) * dx + std::sin(start.yaw) * dy,
                           std::cos(start.yaw) * dy - std::sin(start.yaw) * dx,
                           wrapped(particles.yaw[i] - start.yaw)};
    for (int k = 0; k < 3; ++k) {
      m.mean[k] += step[k] / kCount;
      squares[k] += step[k] * step[k] / kCount;
    }
  }
  for (int k = 0; k < 3; ++k) m.sigma[k] = std::sqrt(squares[k] - m.mean[k] * m.mean[k]);
  return m;
}

TEST_CASE("differential: moments of turn, translation and turn") {
  // E cos(a + s n) = cos a exp(-s^2 / 2), and t is independent of it.
  const Alphas alphas{0.02, 0.01, 0.03, 0.04, 0.0};
  const MotionDraws d =
      motion_draws(MotionModel::kDifferential, {0, 0, 0}, {0.8, 0.6, 0.9}, alphas);
  const double first = std::atan2(0.6, 0.8);
  const double second = 0.9 - first;
  const double t2 = 1.0;
  CHECK(d.sigma[0] == near(std::sqrt(0.02 * first * first + 0.01 * t2), 1e-12));
  CHECK(d.sigma[1] == near(std::sqrt(0.03 * t2 + 0.04 * (first * first + second * second)), 1e-12));
  CHECK(d.sigma[2] == near(std::sqrt(0.02 * second * second + 0.01 * t2), 1e-12));
  const Moments m = moments_of(d, {3, -4, 2.9});
  const double shrunk = std::exp(-0.5 * d.sigma[0] * d.sigma[0]);
  CHECK(m.mean[0] == near(std::cos(first) * shrunk, 0.003));
  CHECK(m.mean[1] == near(std::sin(first) * shrunk, 0.003));
  CHECK(m.mean[2] == near(0.9, 0.002));
  CHECK(m.sigma[2] == near(std::hypot(d.sigma[0], d.sigma[2]), 0.001));
  const double r2 = t2 + d.sigma[1] * d.sigma[1];  // E t^2
  const double twice = std::exp(-2.0 * d.sigma[0] * d.sigma[0]) * std::cos(2.0 * first);
  const double variance = 0.5 * r2 * (1.0 + twice) - std::pow(std::cos(first) * shrunk, 2);
  CHECK(m.sigma[0] == near(std::sqrt(variance), 0.003));
}

TEST_CASE("driving backwards is as noisy as driving ahead") {
  const Alphas alphas{0.1, 0.1, 0.1, 0.1, 0.1};
  const auto ahead = motion_draws(MotionModel::kDifferential, {0, 0, 0}, {1, 0, 0}, alphas);
  const auto back = motion_draws(MotionModel::kDifferential, {0, 0, 0}, {-1, 0, 0}, alphas);
  for (std::size_t k = 0; k < 3; ++k) CHECK(ahead.sigma[k] == near(back.sigma[k], 1e-7));
}

TEST_CASE("a step of a centimetre has no direction, a longer one has") {
  const Alphas none{};
  for (const double step : {0.0, 0.005, 0.01}) {
    CHECK(motion_draws(MotionModel::kDifferential, {}, {0, step, 0}, none).mean[0] == 0.0);
    CHECK(motion_draws(MotionModel::kOmnidirectional, {}, {0, step, 0}, none).bearing_rad == 0.0);
  }
  const Pose2 longer{0, 0.010001, 0};
  CHECK(motion_draws(MotionModel::kDifferential, {}, longer, none).mean[0] ==
        near(0.5 * kPi, 1e-12));
  CHECK(motion_draws(MotionModel::kOmnidirectional, {}, longer, none).bearing_rad ==
        near(0.5 * kPi, 1e-12));
}

TEST_CASE("an omnidirectional turn of 170 degrees has the noise of one of 10") {
  const Alphas alphas{0.1, 0.2, 0.3, 0.4, 0.5};
  const double ten = kPi / 18.0;
  const auto wide = motion_draws(MotionModel::kOmnidirectional, {0, 0, 2},
                                 {1, 0, wrapped(2 + kPi - ten)}, alphas);
  const auto narrow =
      motion_draws(MotionModel::kOmnidirectional, {0, 0, 2}, {1, 0, 2 + ten}, alphas);
  for (std::size_t k = 0; k < 3; ++k) CHECK(wide.sigma[k] == near(narrow.sigma[k], 1e-12));
  CHECK(narrow.sigma[1] == near(std::sqrt(0.1 * ten * ten + 0.2), 1e-12));
}

TEST_CASE("headings stay within (-pi, pi], by every model and by the floor") {
  const Alphas alphas{0.5, 0.5, 0.5, 0.5, 0.5};
  const Pose2 turned{0.3, 0.1, 3.0};
  for (const MotionModel model :
       {MotionModel::kDifferential, MotionModel::kOmnidirectional, MotionModel::kStationary}) {
    Particles particles;
    particles.resize(4000);
    for (std::size_t i = 0; i < 4000; ++i) particles.set(i, {0, 0, i % 2 == 0 ? 3.14 : -3.14});
    const MotionDraws draws = motion_draws(model, {}, turned, alphas);
    for (std::uint64_t step = 0; step < 10; ++step) {
      const MotionFloor floor{0.0, step < 5 ? 0.0 : 0.5};
      move(particles, 0, 4000, draws, floor, {3, step});
      const bool within = std::all_of(particles.yaw.begin(), particles.yaw.end(),
                                      [](double yaw) { return yaw > -kPi && yaw <= kPi; });
      CHECK(within);
    }
  }
}

TEST_CASE("omnidirectional: moments along, across and of the turn") {
  const Alphas alphas{0.02, 0.01, 0.03, 0.04, 0.05};
  const auto d = motion_draws(MotionModel::kOmnidirectional, {1, 2, 0.5},
                              {1 + std::cos(0.5), 2 + std::sin(0.5), 0.8}, alphas);
  const Moments m = moments_of(d, {0, 0, -1.0});
  CHECK(m.mean[0] == near(1.0, 0.002));
  CHECK(m.mean[1] == near(0.0, 0.002));
  CHECK(m.mean[2] == near(0.3, 0.002));
  CHECK(m.sigma[0] == near(std::sqrt(0.03 + 0.04 * 0.09), 0.001));
  CHECK(m.sigma[1] == near(std::sqrt(0.05 + 0.04 * 0.09), 0.001));
  CHECK(m.sigma[2] == near(std::sqrt(0.02 * 0.09 + 0.01), 0.001));
}

TEST_CASE("stationary: 2 cm, 2 cm and 20 mrad, whatever the odometry") {
  const auto d = motion_draws(MotionModel::kStationary, {0, 0, 0}, {5, 5, 1}, {1, 1, 1, 1, 1});
  const Moments m = moments_of(d, {3, 3, 1.0});
  for (int k = 0; k < 3; ++k) {
    CHECK(m.mean[k] == near(0.0, 0.0002));
    CHECK(m.sigma[k] == near(0.02, 0.0002));
  }
}

TEST_CASE("floors add noise at rest, in the map's axes") {
  const auto d = motion_draws(MotionModel::kDifferential, {}, {}, {0.2, 0.2, 0.2, 0.2, 0.2});
  const Moments still = moments_of(d, {1, 1, 1});
  const Moments shaken = moments_of(d, {1, 1, 1}, {0.05, 0.01});
  for (int k = 0; k < 3; ++k) CHECK((still.mean[k] == 0.0 && still.sigma[k] == 0.0));
  CHECK(shaken.sigma[0] == near(0.05, 0.0005));
  CHECK(shaken.sigma[1] == near(0.05, 0.0005));
  CHECK(shaken.sigma[2] == near(0.01, 0.0001));
}

TEST_CASE("the floor's noise is not the motion's") {
  const auto d = motion_draws(MotionModel::kStationary, {}, {}, {});
  const Moments m = moments_of(d, {}, {0.03, 0.03});
  for (int k = 0; k < 3; ++k) CHECK(m.sigma[k] == near(std::hypot(0.02, 0.03), 0.0003));
}

TEST_CASE("turns are angles, whichever way the headings pass pi") {
  const Pose2 driven{std::cos(2.0), -std::sin(2.0), 3.0};
  const auto two = motion_draws(MotionModel::kDifferential, {0, 0, 0}, driven, {});
  CHECK(two.mean[0] == near(-2.0, 1e-12));
  CHECK(two.mean[2] == near(wrapped(5.0), 1e-12));
  const auto one = motion_draws(MotionModel::kOmnidirectional, {0, 0, 3}, {0, 0, -3}, {});
  CHECK(one.mean[1] == near(wrapped(-6.0), 1e-12));
}

TEST_CASE("odometry that is not a number is refused") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(motion_draws(MotionModel::kDifferential, {}, {nan, 0, 0}, {}),
                  std::invalid_argument);
}

}  // namespace
