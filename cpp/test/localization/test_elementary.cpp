// Elementary functions against the library's, and random numbers against published words.
#include <cmath>

#include "check.hpp"
#include "localization/elementary.hpp"
#include "localization/random.hpp"

namespace {

using namespace mapperd::localization;

TEST_CASE("exponential, logarithm, sine and cosine are the library's") {
  double worst = 0.0;
  for (int i = -20000; i <= 20000; ++i) {
    const double x = 0.0314159 * i + 1e-7 * i * i;
    const auto turn = sine_cosine(x);
    worst = std::max({worst, std::abs(turn.sine - std::sin(x)), std::abs(turn.cosine - std::cos(x)),
                      std::abs(exp_of(x) / std::exp(std::min(708.0, std::max(-708.0, x))) - 1.0)});
    const double positive = std::exp(0.03 * i);
    worst = std::max(worst, std::abs(log_of(positive) - std::log(positive)) /
                                std::max(1.0, std::abs(std::log(positive))));
  }
  CHECK(worst < 1e-14);
  for (const double power : {709.0, 1e4, 1e300}) {
    CHECK(exp_of(power) == exp_of(708.0));
    CHECK(exp_of(-power) == exp_of(-708.0));
  }
}

TEST_CASE("an angle is wrapped into (-pi, pi]") {
  CHECK(wrapped(kPi) == kPi);
  CHECK(wrapped(-kPi) == kPi);
  CHECK_NEAR(wrapped(3.0 * kPi), kPi, 1e-15);
  CHECK_NEAR(wrapped(7.0), 7.0 - 2.0 * kPi, 1e-15);
  for (int i = -1000; i < 1000; ++i) {
    const double angle = wrapped(0.37 * i);
    CHECK(angle > -kPi && angle <= kPi);
    CHECK_NEAR(std::sin(angle), std::sin(0.37 * i), 1e-12);
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

TEST_CASE("normal numbers have the moments of normal numbers, whatever their block") {
  double sum[5] = {};
  NormalBlock block;
  NormalBlock one;
  const std::size_t blocks = 4000;
  for (std::size_t b = 0; b < blocks; ++b) {
    draw_normals({7, 3}, Purpose::kMotion, b * kBlock, kBlock, block);
    draw_normals({7, 3}, Purpose::kMotion, b * kBlock + 5, 1, one);
    CHECK(one.number[2][0] == block.number[2][5]);
    for (const auto& row : block.number) {
      for (const double z : row) {
        sum[1] += z;
        sum[2] += z * z;
        sum[3] += z * z * z;
        sum[4] += z * z * z * z;
      }
    }
  }
  const double count = static_cast<double>(4 * blocks * kBlock);
  CHECK_NEAR(sum[1] / count, 0.0, 4.0 / std::sqrt(count));
  CHECK_NEAR(sum[2] / count, 1.0, 4.0 * std::sqrt(2.0 / count));
  CHECK_NEAR(sum[3] / count, 0.0, 4.0 * std::sqrt(15.0 / count));
  CHECK_NEAR(sum[4] / count, 3.0, 4.0 * std::sqrt(96.0 / count));
}

}  // namespace
