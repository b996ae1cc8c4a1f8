#include <cmath>

#include "mapperd/acoustics/echo_response.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

const float kVertical[] = {1.0F, 0.5F, 0.0F};
const acoustics::EchoResponse kResponse{nullptr, kVertical, 3, nullptr, 8, 4};

TEST_CASE("a beam is heard alike above and below its axis, and no farther than its pattern goes") {
  for (const double w : {0.0, 0.25, 0.5, 0.75, 1.0}) {
    CHECK(static_cast<double>(acoustics::vertical_at(kResponse, w)) == near(1.0 - w, 1e-6));
    CHECK(acoustics::vertical_at(kResponse, -w) == acoustics::vertical_at(kResponse, w));
  }
  for (const double w : {1.0 + 1e-15, -1.5, 40.0}) {
    CHECK(acoustics::vertical_at(kResponse, w) == 0.0F);
  }
}

TEST_CASE("a point where the sonar is has a direction of numbers") {
  const acoustics::Leg leg{{4, 5, 6}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1.0};
  const acoustics::PolarPoint at = acoustics::polar_point(leg, {4, 5, 6});
  CHECK((at.range_m > 0.0 && at.s == 0.0 && at.w == 0.0));
  CHECK((at.direction.x == 0.0 && at.direction.y == 0.0 && at.direction.z == 0.0));
  const acoustics::PolarPoint beside = acoustics::polar_point(leg, {4, 2, 10});
  CHECK(beside.range_m == near(5.0, 1e-12));
  CHECK(beside.s == near(0.6, 1e-12));
  CHECK(beside.w == near(0.8, 1e-12));
}

TEST_CASE("an echo between columns has taps of its own fraction, beside the first column too") {
  for (const double column : {-2.9, -0.3, 0.0, 0.49, 7.999999}) {
    const acoustics::Spread at = acoustics::spread_at(kResponse, column);
    CHECK(at.column == static_cast<std::ptrdiff_t>(std::floor(column)) - 1);
    CHECK(at.fraction == static_cast<std::size_t>(8.0 * (column - std::floor(column))));
  }
  // Rounded, a place just before a column lies a whole one behind the last.
  CHECK(acoustics::spread_at(kResponse, -1e-20).fraction == 7);
}

}  // namespace
