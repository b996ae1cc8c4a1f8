/// \file
/// \brief Circular complex Gaussian numbers as functions of a key, independent of order and thread.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/random.hpp"

namespace mapperd::acoustics {

/// A complex number with independent normal parts.
struct Gaussian {
  float re, im;
};

/// 64 random bits as a circular complex Gaussian number of mean power 1 (Box and Muller 1958): the
/// upper half gives the amplitude by 24 bits, the lower one the angle by 21 bits within an octant,
/// and three select the octant. Powers above 17.3 (probability 3e-8) do not occur.
MAPPERD_INLINE Gaussian gaussian_of(std::uint32_t upper, std::uint32_t lower) {
  constexpr float kEighthTurn = 0.78539816F;
  const float level = (static_cast<float>(static_cast<std::int32_t>(upper >> 8)) + 0.5F) * 0x1p-24F;
  const float minus_log = -fast_log(level);
  const float amplitude = std::sqrt(minus_log > 0.0F ? minus_log : 0.0F);
  const auto fine = static_cast<std::int32_t>(lower & 0x1FFFFFU);
  const float angle = (static_cast<float>(fine) + 0.5F) * (0x1p-21F * kEighthTurn);
  const float along = amplitude * octant_cos(angle);
  const float across = amplitude * octant_sin(angle);
  const bool swapped = (lower & 0x200000U) != 0;
  const auto re_sign = static_cast<std::int32_t>((lower << 9) & 0x80000000U);
  const auto im_sign = static_cast<std::int32_t>((lower << 8) & 0x80000000U);
  return {float_of(bits_of(swapped ? across : along) ^ re_sign),
          float_of(bits_of(swapped ? along : across) ^ im_sign)};
}

/// A circular complex Gaussian number of mean power 1.
inline std::complex<float> complex_gaussian(std::uint64_t key) {
  const std::uint64_t bits = mix(key);
  const Gaussian number =
      gaussian_of(static_cast<std::uint32_t>(bits >> 32), static_cast<std::uint32_t>(bits));
  return {number.re, number.im};
}

/// The numbers of the keys mix(key) + first, mix(key) + first + 1 and so on, real and imaginary
/// parts in turn.
void complex_gaussians(std::uint64_t key, std::uint64_t first, std::size_t count, float* out);

}  // namespace mapperd::acoustics
