#include "acoustics/deposit.hpp"

#include <cmath>
#include <cstring>

#include "acoustics/fast_math.hpp"

namespace acoustics {

namespace {

// sin(2 pi y) for |y| <= 1/4: Taylor's series with the last term fitted; within 4e-7.
ACOUSTICS_INLINE float sine_turns(float y) {
  const float z = y * y;
  float sum = 39.6F;
  sum = sum * z - 76.7028F;
  sum = sum * z + 81.605165F;
  sum = sum * z - 41.341702F;
  sum = sum * z + 6.2831853F;
  return y * sum;
}

// -ln of a number in (0, 1): exponent and a series of the mantissa's atanh; within 2e-6.
ACOUSTICS_INLINE float minus_log(float x) {
  std::int32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  const std::int32_t exponent = (bits - 0x3F3504F3) >> 23;
  bits -= exponent * 0x800000;
  float mantissa;
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  const float t = (mantissa - 1.0F) / (mantissa + 1.0F);
  const float z = t * t;
  const float series = t * (2.0F + z * (0.6666667F + z * (0.4F + z * 0.2857143F)));
  return -(static_cast<float>(exponent) * 0.69314718F + series);
}

// Circular complex Gaussian numbers of the given rms, turned by a phase.
ACOUSTICS_VECTORISED void drawn(const float* rms, const float* phase, const float* level,
                                std::size_t count, float* __restrict real,
                                float* __restrict imaginary) {
  for (std::size_t i = 0; i < count; ++i) {
    const float pressure = rms[i] * std::sqrt(minus_log(level[i]));
    // Fold the angle: cosine and sine are sines of at most a quarter turn.
    const float turns = phase[i];
    const float angle = turns - static_cast<float>(static_cast<std::int32_t>(turns + 0.5F));
    const float half = std::fabs(angle);
    const float upper = 0.25F - std::fabs(half - 0.25F);
    real[i] = pressure * sine_turns(0.25F - half);
    imaginary[i] = pressure * sine_turns(std::copysign(upper, angle));
  }
}

template <std::size_t kTaps>
inline void spread(std::complex<float>* cell, const float* taps, float real, float imaginary) {
  float out[2 * kTaps];
  std::memcpy(out, cell, sizeof out);
  for (std::size_t k = 0; k < kTaps; ++k) {
    out[2 * k] += taps[k] * real;
    out[2 * k + 1] += taps[k] * imaginary;
  }
  std::memcpy(static_cast<void*>(cell), out, sizeof out);
}

}  // namespace

Deposit::Deposit(const Hearing& response, std::complex<float>* field, std::ptrdiff_t columns)
    : field_(field), columns_(columns), table_(response.taps), tap_count_(response.tap_count) {}

void Deposit::draw() {
  drawn(pressure_.data(), turns_.data(), level_.data(), count_, real_.data(), imaginary_.data());
}

void Deposit::flush() {
  draw();
  if (tap_count_ == 6) {
    for (std::size_t i = 0; i < count_; ++i) {
      spread<6>(field_ + cell_[i], table_ + taps_[i], real_[i], imaginary_[i]);
    }
  } else {
    for (std::size_t i = 0; i < count_; ++i) {
      for (std::size_t k = 0; k < tap_count_; ++k) {
        field_[cell_[i] + static_cast<std::ptrdiff_t>(k)] +=
            table_[taps_[i] + k] * std::complex<float>(real_[i], imaginary_[i]);
      }
    }
  }
  count_ = 0;
}

}  // namespace acoustics
