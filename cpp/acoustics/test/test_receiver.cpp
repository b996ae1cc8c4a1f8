#include <cmath>
#include <limits>
#include <vector>

#include "mapperd/acoustics/receiver.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

using acoustics::Receiver;

template <typename Pixel>
std::vector<Pixel> pixels(const std::vector<float>& amplitude, float gamma, unsigned threads = 2) {
  std::vector<Pixel> out(amplitude.size());
  acoustics::quantised(amplitude.data(), amplitude.size(), Receiver{nullptr, gamma, true},
                       out.data(), threads);
  return out;
}

TEST_CASE("amplitudes of a field and of its power are alike, after gain") {
  const std::vector<float> field{3.0F, 4.0F, 0.0F, -2.0F, 6.0F, 8.0F, 0.0F, 0.0F};
  const std::vector<float> power{25.0F, 4.0F, 100.0F, 0.0F};
  const std::vector<float> gain{0.5F, 2.0F};
  const std::vector<float> expected{2.5F, 1.0F, 20.0F, 0.0F};
  std::vector<float> out(4);
  acoustics::amplitudes(field.data(), 2, 2, 2, {gain.data(), 1.0F, false}, out.data(), 2);
  CHECK(out == expected);
  acoustics::amplitudes(power.data(), 1, 2, 2, {gain.data(), 1.0F, false}, out.data(), 2);
  CHECK(out == expected);
}

TEST_CASE("what is not a number is silence, what is endless is finite") {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float endless = std::numeric_limits<float>::infinity();
  const std::vector<float> power{nan, endless, -1.0F, 1.0F};
  const float gain = 1.0F;
  std::vector<float> out(4);
  acoustics::amplitudes(power.data(), 1, 1, 4, {&gain, 1.0F, false}, out.data(), 1);
  CHECK((out[0] == 0.0F && std::isfinite(out[1]) && out[2] == 0.0F && out[3] == 1.0F));
  CHECK(pixels<std::uint8_t>(out, 0.5F)[1] == 255);
  const std::vector<float> field{nan, 1.0F, endless, 0.0F};
  acoustics::amplitudes(field.data(), 2, 1, 2, {&gain, 1.0F, false}, out.data(), 1);
  CHECK((out[0] == 0.0F && std::isfinite(out[1]) && out[1] > 1.0F));
}

TEST_CASE("the pixel is the nearest integer of the power law") {
  std::vector<float> amplitude;
  for (float value = 1e-6F; value < 1.5F; value *= 1.0013F) amplitude.push_back(value);
  for (const float gamma : {127.0F / 255.0F, 0.8F, 1.0F}) {
    const auto eight = pixels<std::uint8_t>(amplitude, gamma);
    const auto sixteen = pixels<std::uint16_t>(amplitude, gamma);
    for (std::size_t i = 0; i < amplitude.size(); ++i) {
      const double curve =
          std::pow(std::min(1.0, static_cast<double>(amplitude[i])), static_cast<double>(gamma));
      CHECK(static_cast<double>(eight[i]) == near(255.0 * curve, 0.5001));
      CHECK(static_cast<double>(sixteen[i]) == near(65535.0 * curve, 0.55));
    }
  }
}

TEST_CASE("every width ends at its greatest integer and does not wrap") {
  const std::vector<float> amplitude{0.0F, 1.0F, 1.5F, 1e18F};
  CHECK((pixels<std::uint8_t>(amplitude, 1.0F) == std::vector<std::uint8_t>{0, 255, 255, 255}));
  CHECK((pixels<std::uint16_t>(amplitude, 0.5F) ==
         std::vector<std::uint16_t>{0, 65535, 65535, 65535}));
  constexpr std::uint32_t kEnd = 0xFFFFFFFFU;
  CHECK(
      (pixels<std::uint32_t>(amplitude, 1.0F) == std::vector<std::uint32_t>{0, kEnd, kEnd, kEnd}));
}

TEST_CASE("floats keep what exceeds full scale unless the receiver clips") {
  const std::vector<float> amplitude{0.25F, 4.0F};
  std::vector<float> out(2);
  acoustics::apply_gamma(amplitude.data(), 2, {nullptr, 1.0F, true}, out.data(), 1);
  CHECK((out[0] == 0.25F && out[1] == 1.0F));
  acoustics::apply_gamma(amplitude.data(), 2, {nullptr, 0.5F, false}, out.data(), 1);
  CHECK(static_cast<double>(out[1]) == near(2.0, 1e-6));
}

TEST_CASE("pixels are the same for any number of threads") {
  std::vector<float> amplitude(10000);
  for (std::size_t i = 0; i < amplitude.size(); ++i) {
    amplitude[i] = static_cast<float>(i * 7919 % 10007) / 10007.0F;
  }
  const auto alone = pixels<std::uint16_t>(amplitude, 0.5F, 1);
  for (const unsigned threads : {2U, 3U, 50U}) {
    CHECK(pixels<std::uint16_t>(amplitude, 0.5F, threads) == alone);
  }
}

}  // namespace
