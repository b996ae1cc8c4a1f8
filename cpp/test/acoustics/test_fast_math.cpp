#include <algorithm>
#include <cmath>

#include "acoustics/fast_math.hpp"
#include "check.hpp"

namespace {

TEST_CASE("the logarithm is right over all normal numbers") {
  double worst = 0.0;
  for (float value = 1.2e-38F; value < 1e38F; value *= 1.00037F) {
    const double exact = std::log(static_cast<double>(value));
    const double error = std::abs(static_cast<double>(acoustics::fast_log(value)) - exact);
    worst = std::max(worst, error / std::max(1.0, std::abs(exact)));
  }
  CHECK(worst < 2.5e-7);
}

TEST_CASE("the logarithm of one is zero and nothing jumps about the mantissa's seam") {
  CHECK(acoustics::fast_log(1.0F) == 0.0F);
  const float seam = std::sqrt(0.5F);
  const float below = acoustics::fast_log(std::nextafter(seam, 0.0F));
  CHECK_NEAR(static_cast<double>(acoustics::fast_log(seam) - below), 0.0, 2e-7);
}

TEST_CASE("powers of two are right and stay finite at both ends") {
  double worst = 0.0;
  for (float power = -125.9F; power < 125.9F; power += 0.00713F) {
    const double exact = std::exp2(static_cast<double>(power));
    worst =
        std::max(worst, std::abs(static_cast<double>(acoustics::fast_exp2(power)) / exact - 1.0));
  }
  CHECK(worst < 2.5e-7);
  for (const float power : {126.5F, 150.0F, 1e9F}) {
    CHECK(acoustics::fast_exp2(power) == acoustics::fast_exp2(126.0F));
    CHECK(acoustics::fast_exp2(-power) == acoustics::fast_exp2(-126.0F));
  }
  CHECK(acoustics::fast_exp2(10.0F) == 1024.0F);
}

TEST_CASE("powers are right to a sixteen-bit pixel's tenth") {
  double worst = 0.0;
  for (const float gamma : {0.1F, 127.0F / 255.0F, 0.75F, 1.5F}) {
    for (float base = 1e-9F; base <= 1.0F; base *= 1.0103F) {
      const double exact = std::pow(static_cast<double>(base), static_cast<double>(gamma));
      worst = std::max(worst,
                       std::abs(static_cast<double>(acoustics::fast_power(base, gamma)) - exact));
    }
  }
  CHECK(worst < 0.1 / 65535.0);
  CHECK(acoustics::fast_power(0.0F, 0.1F) == 0.0F);
  CHECK(acoustics::fast_power(1.0F, 0.5F) == 1.0F);
}

TEST_CASE("sine and cosine are right in their octant") {
  double worst = 0.0;
  for (float angle = 0.0F; angle <= 0.78539816F; angle += 1e-4F) {
    const auto exact = static_cast<double>(angle);
    worst = std::max(worst,
                     std::abs(static_cast<double>(acoustics::octant_cos(angle)) - std::cos(exact)));
    worst = std::max(worst,
                     std::abs(static_cast<double>(acoustics::octant_sin(angle)) - std::sin(exact)));
  }
  CHECK(worst < 4e-7);
}

}  // namespace
