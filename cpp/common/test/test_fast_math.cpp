// Fast elementary functions against the standard library's, random words against published ones.
#include <algorithm>
#include <cmath>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/random.hpp"
#include "testing.hpp"

namespace {

using namespace mapperd;

TEST_CASE("the logarithm is right over all normal numbers") {
  double worst = 0.0;
  for (float value = 1.2e-38F; value < 1e38F; value *= 1.00037F) {
    const double exact = std::log(static_cast<double>(value));
    const double error = std::abs(static_cast<double>(fast_log(value)) - exact);
    worst = std::max(worst, error / std::max(1.0, std::abs(exact)));
  }
  CHECK(worst < 2.5e-7);
}

TEST_CASE("the logarithm of one is zero and nothing jumps about the mantissa's seam") {
  CHECK(fast_log(1.0F) == 0.0F);
  const float seam = std::sqrt(0.5F);
  const float below = fast_log(std::nextafter(seam, 0.0F));
  CHECK(static_cast<double>(fast_log(seam) - below) == near(0.0, 2e-7));
}

TEST_CASE("powers of two are right and stay finite at both ends") {
  double worst = 0.0;
  for (float power = -125.9F; power < 125.9F; power += 0.00713F) {
    const double exact = std::exp2(static_cast<double>(power));
    worst = std::max(worst, std::abs(static_cast<double>(fast_exp2(power)) / exact - 1.0));
  }
  CHECK(worst < 2.5e-7);
  for (const float power : {126.5F, 150.0F, 1e9F}) {
    CHECK(fast_exp2(power) == fast_exp2(126.0F));
    CHECK(fast_exp2(-power) == fast_exp2(-126.0F));
  }
  CHECK(fast_exp2(10.0F) == 1024.0F);
}

TEST_CASE("powers are right to a sixteen-bit pixel's tenth") {
  double worst = 0.0;
  for (const float gamma : {0.1F, 127.0F / 255.0F, 0.75F, 1.5F}) {
    for (float base = 1e-9F; base <= 1.0F; base *= 1.0103F) {
      const double exact = std::pow(static_cast<double>(base), static_cast<double>(gamma));
      worst = std::max(worst, std::abs(static_cast<double>(fast_power(base, gamma)) - exact));
    }
  }
  CHECK(worst < 0.1 / 65535.0);
  CHECK(fast_power(0.0F, 0.1F) == 0.0F);
  CHECK(fast_power(1.0F, 0.5F) == 1.0F);
}

TEST_CASE("sine and cosine are right in their octant") {
  double worst = 0.0;
  for (float angle = 0.0F; angle <= 0.78539816F; angle += 1e-4F) {
    const auto exact = static_cast<double>(angle);
    worst = std::max(worst, std::abs(static_cast<double>(octant_cos(angle)) - std::cos(exact)));
    worst = std::max(worst, std::abs(static_cast<double>(octant_sin(angle)) - std::sin(exact)));
  }
  CHECK(worst < 4e-7);
}

TEST_CASE("exponential, logarithm, sine and cosine are the library's") {
  double worst = 0.0;
  for (int i = -20000; i <= 20000; ++i) {
    const double x = 0.0314159 * i + 1e-7 * i * i;
    const auto turn = fast_sine_cosine(x);
    worst =
        std::max({worst, std::abs(turn.sine - std::sin(x)), std::abs(turn.cosine - std::cos(x)),
                  std::abs(fast_exp(x) / std::exp(std::min(708.0, std::max(-708.0, x))) - 1.0)});
    const double positive = std::exp(0.03 * i);
    worst = std::max(worst, std::abs(fast_log(positive) - std::log(positive)) /
                                std::max(1.0, std::abs(std::log(positive))));
  }
  CHECK(worst < 1e-14);
  for (const double power : {709.0, 1e4, 1e300}) {
    CHECK(fast_exp(power) == fast_exp(708.0));
    CHECK(fast_exp(-power) == fast_exp(-708.0));
  }
}

TEST_CASE("an angle is wrapped into (-pi, pi]") {
  CHECK(wrapped(kPi) == kPi);
  CHECK(wrapped(-kPi) == kPi);
  CHECK(wrapped(3.0 * kPi) == near(kPi, 1e-15));
  CHECK(wrapped(7.0) == near(7.0 - 2.0 * kPi, 1e-15));
  for (int i = -1000; i < 1000; ++i) {
    const double angle = wrapped(0.37 * i);
    CHECK((angle > -kPi && angle <= kPi));
    CHECK(std::sin(angle) == near(std::sin(0.37 * i), 1e-12));
  }
}

TEST_CASE("the generator gives the words that its authors published") {
  const Words zero = philox({{0, 0, 0, 0}}, 0);
  const std::uint32_t of_zero[] = {0x6627e8d5U, 0xe169c58dU, 0xbc57ac4cU, 0x9b00dbd8U};
  const std::uint32_t all = 0xffffffffU;
  const Words ones = philox({{all, all, all, all}}, 0xffffffffffffffffULL);
  const std::uint32_t of_ones[] = {0x408f276dU, 0x41c83b0eU, 0xa20bc7c6U, 0x6d5451fdU};
  for (int k = 0; k < 4; ++k) {
    CHECK(zero.word[k] == of_zero[k]);
    CHECK(ones.word[k] == of_ones[k]);
  }
}

}  // namespace
