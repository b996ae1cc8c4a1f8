#include <cmath>
#include <cstdint>

#include "mapperd/acoustics/lattice.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr double kPi = 3.14159265358979323846;

TEST_CASE("steps are powers of the fourth root of two") {
  for (int level = -66; level <= 39; ++level) {
    const double step_m = std::exp2(0.25 * level);
    CHECK(std::fabs(acoustics::step_of(level) / step_m - 1.0) < 1e-15);
    CHECK(acoustics::level_of(1.0001 * step_m) == level);
    CHECK(acoustics::level_of(0.9999 * step_m) == level - 1);
  }
  CHECK(acoustics::level_of(0.0) == acoustics::level_of(1e-5));
  CHECK(acoustics::level_of(1e9) == acoustics::level_of(1e3));
}

TEST_CASE("turns are the nearest of a direction and its opposite") {
  for (int degree = 0; degree < 360; ++degree) {
    const double angle = (degree + 0.1) * kPi / 180.0;
    const double u = 3.0 * std::cos(angle);
    const double v = 3.0 * std::sin(angle);
    const long nearest = std::lround(std::atan2(v, u) * acoustics::kTurns / kPi);
    CHECK(acoustics::turn_of(u, v) == (static_cast<int>(nearest) & (acoustics::kTurns - 1)));
  }
  for (int turn = 0; turn < acoustics::kTurns; ++turn) {
    CHECK(std::fabs(acoustics::kCosine[turn] - std::cos(turn * kPi / acoustics::kTurns)) < 1e-15);
    CHECK(std::fabs(acoustics::kSine[turn] - std::sin(turn * kPi / acoustics::kTurns)) < 1e-15);
  }
}

// How far a bit is from a fair coin, in standard deviations of the share of ones.
double unfairness(double ones, double count) {
  return std::fabs(ones - 0.5 * count) / (0.5 * std::sqrt(count));
}

TEST_CASE("each bit of a node is fair, and independent of a neighbour's and of the other word") {
  constexpr std::uint32_t kSide = 300;
  constexpr double kCount = kSide * kSide;
  const auto at = [](std::uint32_t i, std::uint32_t j) {
    return acoustics::node_bits(0x12345678U, 0x9ABCDEF0U, i, j);
  };
  for (int bit = 0; bit < 32; ++bit) {
    double ones = 0.0;
    double echoes = 0.0;
    double along = 0.0;
    double across = 0.0;
    double same = 0.0;
    for (std::uint32_t i = 0; i < kSide; ++i) {
      for (std::uint32_t j = 0; j < kSide; ++j) {
        const acoustics::NodeBits here = at(i, j);
        ones += here.place >> bit & 1U;
        echoes += here.echo >> bit & 1U;
        along += (here.echo ^ at(i + 1, j).echo) >> bit & 1U;
        across += (here.place ^ at(i, j + 1).place) >> bit & 1U;
        same += (here.place ^ here.echo) >> bit & 1U;
      }
    }
    for (const double count : {ones, echoes, along, across, same}) {
      CHECK(unfairness(count, kCount) < 4.5);
    }
  }
}

}  // namespace
