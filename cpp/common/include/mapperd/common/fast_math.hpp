/// \file
/// \brief Elementary functions as short series without branches, so that loops over them become
/// vector code; the same operations in the same order everywhere give the same bits everywhere.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstdint>
#include <cstring>

#include "mapperd/common/simd.hpp"

namespace mapperd {

// Single precision.

MAPPERD_INLINE std::int32_t bits_of(float value) {
  std::int32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

MAPPERD_INLINE float float_of(std::int32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

/// Natural logarithm of a normal positive number, to some 2e-7 absolutely.
/// The mantissa is taken from [sqrt(1/2), sqrt(2)); log m = 2 artanh((m - 1) / (m + 1)).
MAPPERD_INLINE float fast_log(float value) {
  constexpr std::int32_t kRootHalf = 0x3F3504F3;
  const std::int32_t bits = bits_of(value);
  const std::int32_t exponent = (bits - kRootHalf) >> 23;
  const float mantissa = float_of(bits - exponent * (1 << 23));
  const float s = (mantissa - 1.0F) / (mantissa + 1.0F);
  const float s2 = s * s;
  const float series =
      2.0F + s2 * (2.0F / 3.0F + s2 * (2.0F / 5.0F + s2 * (2.0F / 7.0F + s2 * (2.0F / 9.0F))));
  return s * series + static_cast<float>(exponent) * 0.69314718F;
}

/// 2 to a power between -126 and 126, to some 2e-7 relatively: Taylor about the nearest integer.
MAPPERD_INLINE float fast_exp2(float power) {
  const float clipped = power < -126.0F ? -126.0F : (power > 126.0F ? 126.0F : power);
  const auto whole = static_cast<std::int32_t>(clipped + (clipped < 0.0F ? -0.5F : 0.5F));
  const float x = (clipped - static_cast<float>(whole)) * 0.69314718F;
  const float series =
      1.0F +
      x * (1.0F + x * (0.5F + x * (1.0F / 6 +
                                   x * (1.0F / 24 +
                                        x * (1.0F / 120 + x * (1.0F / 720 + x * (1.0F / 5040)))))));
  return series * float_of((whole + 127) * (1 << 23));
}

/// base^power for 0 <= base < 1e38 and |power| <= 2; bases under 1e-37 count as 0.
MAPPERD_INLINE float fast_power(float base, float power) {
  // With bit operations, because a conditional would become a branch.
  const std::int32_t some = -static_cast<std::int32_t>(base > 1e-37F);
  const float raised = fast_exp2(power * 1.44269504F * fast_log(base > 1e-37F ? base : 1e-37F));
  return float_of(bits_of(raised) & some);
}

/// Cosine and sine for 0 <= angle <= pi/4, by Taylor.
MAPPERD_INLINE float octant_cos(float angle) {
  const float x2 = angle * angle;
  return 1.0F + x2 * (-0.5F + x2 * (1.0F / 24 + x2 * (-1.0F / 720 + x2 * (1.0F / 40320))));
}

MAPPERD_INLINE float octant_sin(float angle) {
  const float x2 = angle * angle;
  return angle * (1.0F + x2 * (-1.0F / 6 + x2 * (1.0F / 120 + x2 * (-1.0F / 5040))));
}

// Double precision, to a relative error of about 1e-15.

inline constexpr double kPi = 3.14159265358979323846;

MAPPERD_INLINE std::uint64_t bits_of(double value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

MAPPERD_INLINE double double_of(std::uint64_t bits) {
  double value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

/// Added to a number below 2^51, it leaves the nearest whole number in the lowest bits.
inline constexpr double kRounder = 6755399441055744.0;  ///< 1.5 * 2^52

MAPPERD_INLINE double nearest_whole(double value) { return (value + kRounder) - kRounder; }

/// The angle in (-pi, pi].
MAPPERD_INLINE double wrapped(double angle) {
  const double turned = angle - 2.0 * kPi * nearest_whole(angle * (0.5 / kPi));
  return turned > -kPi ? turned : turned + 2.0 * kPi;
}

/// e to a power, which is cut to +-708: Taylor about the nearest multiple of ln 2.
MAPPERD_INLINE double fast_exp(double power) {
  constexpr double kLog2E = 1.44269504088896340736;
  constexpr double kLn2High = 6.93147180369123816490e-01;  // its product with a small number is
  constexpr double kLn2Low = 1.90821492927058770002e-10;   // exact; with the rest of ln 2
  const double above = power < 708.0 ? power : 708.0;
  const double cut = above > -708.0 ? above : -708.0;
  const double rounded = cut * kLog2E + kRounder;
  const double whole = rounded - kRounder;
  const double r = (cut - whole * kLn2High) - whole * kLn2Low;
  double series = 1.0 / 6227020800.0;
  series = series * r + 1.0 / 479001600.0;
  series = series * r + 1.0 / 39916800.0;
  series = series * r + 1.0 / 3628800.0;
  series = series * r + 1.0 / 362880.0;
  series = series * r + 1.0 / 40320.0;
  series = series * r + 1.0 / 5040.0;
  series = series * r + 1.0 / 720.0;
  series = series * r + 1.0 / 120.0;
  series = series * r + 1.0 / 24.0;
  series = series * r + 1.0 / 6.0;
  series = series * r + 0.5;
  series = series * r + 1.0;
  series = series * r + 1.0;
  return series * double_of((bits_of(rounded) << 52) + (std::uint64_t{1023} << 52));
}

/// A positive number as mantissa * 2^exponent.
struct Split {
  double mantissa;  ///< in [sqrt(1/2), sqrt(2))
  double exponent;
};

/// A positive normal number as mantissa * 2^exponent.
MAPPERD_INLINE Split split(double value) {
  constexpr std::uint64_t kRootHalf = 0x3FE6A09E667F3BCDULL;
  const std::uint64_t bits = bits_of(value);
  const std::uint64_t biased = (bits - kRootHalf + (std::uint64_t{1023} << 52)) >> 52;
  const double exponent = double_of(biased | 0x4330000000000000ULL) - 4503599627370496.0 - 1023.0;
  return {double_of(bits - (biased << 52) + (std::uint64_t{1023} << 52)), exponent};
}

/// Natural logarithm of a positive normal number: log m = 2 artanh((m - 1) / (m + 1)).
MAPPERD_INLINE double fast_log(double value) {
  const Split parts = split(value);
  const double s = (parts.mantissa - 1.0) / (parts.mantissa + 1.0);
  const double s2 = s * s;
  double series = 2.0 / 21.0;
  series = series * s2 + 2.0 / 19.0;
  series = series * s2 + 2.0 / 17.0;
  series = series * s2 + 2.0 / 15.0;
  series = series * s2 + 2.0 / 13.0;
  series = series * s2 + 2.0 / 11.0;
  series = series * s2 + 2.0 / 9.0;
  series = series * s2 + 2.0 / 7.0;
  series = series * s2 + 2.0 / 5.0;
  series = series * s2 + 2.0 / 3.0;
  series = series * s2 + 2.0;
  return s * series + parts.exponent * 0.69314718055994530942;
}

/// Sine and cosine of one angle.
struct SineCosine {
  double sine, cosine;
};

/// Of an angle below some 1e6: Taylor about the nearest multiple of pi / 2.
MAPPERD_INLINE SineCosine fast_sine_cosine(double angle) {
  constexpr double kQuarterHigh = 1.57079632673412561417e+00;  // 33 bits of pi / 2
  constexpr double kQuarterLow = 6.07710050650619224932e-11;
  const double rounded = angle * (2.0 / kPi) + kRounder;
  const double whole = rounded - kRounder;
  const double r = (angle - whole * kQuarterHigh) - whole * kQuarterLow;
  const double r2 = r * r;
  double odd = -1.0 / 1307674368000.0;
  odd = odd * r2 + 1.0 / 6227020800.0;
  odd = odd * r2 - 1.0 / 39916800.0;
  odd = odd * r2 + 1.0 / 362880.0;
  odd = odd * r2 - 1.0 / 5040.0;
  odd = odd * r2 + 1.0 / 120.0;
  odd = odd * r2 - 1.0 / 6.0;
  odd = (odd * r2) * r + r;
  double even = 1.0 / 20922789888000.0;
  even = even * r2 - 1.0 / 87178291200.0;
  even = even * r2 + 1.0 / 479001600.0;
  even = even * r2 - 1.0 / 3628800.0;
  even = even * r2 + 1.0 / 40320.0;
  even = even * r2 - 1.0 / 720.0;
  even = even * r2 + 1.0 / 24.0;
  even = even * r2 - 0.5;
  even = even * r2 + 1.0;
  // Without branches: the quarter selects sine or cosine, and the signs.
  const std::uint64_t quarter = bits_of(rounded);
  const std::uint64_t swap = std::uint64_t{0} - (quarter & 1U);
  const std::uint64_t mixed = (bits_of(odd) ^ bits_of(even)) & swap;
  const std::uint64_t sine_sign = (quarter & 2U) << 62;
  const std::uint64_t cosine_sign = ((quarter + 1U) & 2U) << 62;
  return {double_of((bits_of(odd) ^ mixed) ^ sine_sign),
          double_of((bits_of(even) ^ mixed) ^ cosine_sign)};
}

}  // namespace mapperd
