#include "mapperd/acoustics/receiver.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "mapperd/acoustics/row_bands.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

constexpr float kMaxPressure = 1e18F;  // its square is still a float

MAPPERD_INLINE float clamp_amplitude(float value) {
  // A comparison with what is not a number fails.
  return value > 0.0F ? (value < kMaxPressure ? value : kMaxPressure) : 0.0F;
}

MAPPERD_VECTORISED void complex_row(const float* from, std::size_t count, float gain, float* to) {
  for (std::size_t i = 0; i < count; ++i) {
    const float re = from[2 * i];
    const float im = from[2 * i + 1];
    to[i] = clamp_amplitude(std::sqrt(re * re + im * im) * gain);
  }
}

MAPPERD_VECTORISED void power_row(const float* from, std::size_t count, float gain, float* to) {
  // Powers may be as large as the square of what an amplitude may be.
  for (std::size_t i = 0; i < count; ++i) {
    to[i] = clamp_amplitude(std::sqrt(from[i] > 0.0F ? from[i] : 0.0F) * gain);
  }
}

MAPPERD_VECTORISED void curve(const float* from, std::size_t count, float gamma, float top,
                              float* to) {
  for (std::size_t i = 0; i < count; ++i) to[i] = from[i] < top ? from[i] : top;
  if (gamma == 1.0F) return;
  for (std::size_t i = 0; i < count; ++i) to[i] = fast_power(to[i], gamma);
}

MAPPERD_VECTORISED void rounded(const float* from, std::size_t count, float end, std::int32_t* to) {
  for (std::size_t i = 0; i < count; ++i) to[i] = static_cast<std::int32_t>(from[i] * end + 0.5F);
}

void round_into(const float* from, std::size_t count, std::uint32_t* to) {
  constexpr double kEnd = std::numeric_limits<std::uint32_t>::max();
  for (std::size_t i = 0; i < count; ++i) {
    to[i] = static_cast<std::uint32_t>(static_cast<double>(from[i]) * kEnd + 0.5);
  }
}

template <typename Pixel>
void round_into(const float* from, std::size_t count, Pixel* to) {
  std::int32_t whole[1024];
  rounded(from, count, static_cast<float>(std::numeric_limits<Pixel>::max()), whole);
  for (std::size_t i = 0; i < count; ++i) to[i] = static_cast<Pixel>(whole[i]);
}

template <typename Pixel>
void quantise(const float* amplitude, std::size_t count, const Receiver& receiver, Pixel* out,
              unsigned threads) {
  constexpr std::size_t kBlock = 1024;
  const float gamma = receiver.gamma;
  in_row_bands((count + kBlock - 1) / kBlock, threads, [=](std::size_t block, std::size_t last) {
    float raised[kBlock];
    for (; block < last; ++block) {
      const std::size_t start = block * kBlock;
      const std::size_t size = std::min(kBlock, count - start);
      curve(amplitude + start, size, gamma, 1.0F, raised);
      for (std::size_t i = 0; i < size; ++i) raised[i] = std::min(raised[i], 1.0F);
      round_into(raised, size, out + start);
    }
  });
}

}  // namespace

void amplitudes(const float* beams, std::size_t parts, std::size_t rows, std::size_t count,
                const Receiver& receiver, float* out, unsigned threads) {
  const float* gain = receiver.gain;
  const auto row_of = parts == 2 ? complex_row : power_row;
  in_row_bands(rows, threads, [=](std::size_t row, std::size_t last) {
    for (; row < last; ++row) {
      row_of(beams + row * count * parts, count, gain[row], out + row * count);
    }
  });
}

void apply_gamma(const float* amplitude, std::size_t count, const Receiver& receiver, float* out,
                 unsigned threads) {
  constexpr std::size_t kBlock = 1024;
  const float top = receiver.clip ? 1.0F : kMaxPressure;
  const float gamma = receiver.gamma;
  in_row_bands((count + kBlock - 1) / kBlock, threads, [=](std::size_t block, std::size_t last) {
    for (; block < last; ++block) {
      const std::size_t start = block * kBlock;
      curve(amplitude + start, std::min(kBlock, count - start), gamma, top, out + start);
    }
  });
}

void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint8_t* out, unsigned threads) {
  quantise(amplitude, count, receiver, out, threads);
}

void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint16_t* out, unsigned threads) {
  quantise(amplitude, count, receiver, out, threads);
}

void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint32_t* out, unsigned threads) {
  quantise(amplitude, count, receiver, out, threads);
}

}  // namespace mapperd::acoustics
