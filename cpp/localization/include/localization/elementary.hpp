// Elementary functions in double precision without branches, so that loops over them become vector
// code, with the same bits on every machine. Errors are some 1e-15 relatively.
#pragma once

#include <cstdint>
#include <cstring>

#include "localization/vectorised.hpp"

namespace mapperd::localization {

inline constexpr double kPi = 3.14159265358979323846;

LOCALIZATION_INLINE std::uint64_t bits_of(double value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

LOCALIZATION_INLINE double double_of(std::uint64_t bits) {
  double value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

// Added to a number below 2^51, it leaves the nearest whole number in the lowest bits.
inline constexpr double kRounder = 6755399441055744.0;  // 1.5 * 2^52

LOCALIZATION_INLINE double nearest_whole(double value) { return (value + kRounder) - kRounder; }

// The angle in (-pi, pi].
LOCALIZATION_INLINE double wrapped(double angle) {
  const double turned = angle - 2.0 * kPi * nearest_whole(angle * (0.5 / kPi));
  return turned > -kPi ? turned : turned + 2.0 * kPi;
}

// e to a power, which is cut to +-708: Taylor about the nearest multiple of ln 2.
LOCALIZATION_INLINE double exp_of(double power) {
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

struct Split {
  double mantissa;  // in [sqrt(1/2), sqrt(2))
  double exponent;
};

// A positive normal number as mantissa * 2^exponent.
LOCALIZATION_INLINE Split split(double value) {
  constexpr std::uint64_t kRootHalf = 0x3FE6A09E667F3BCDULL;
  const std::uint64_t bits = bits_of(value);
  const std::uint64_t biased = (bits - kRootHalf + (std::uint64_t{1023} << 52)) >> 52;
  const double exponent = double_of(biased | 0x4330000000000000ULL) - 4503599627370496.0 - 1023.0;
  return {double_of(bits - (biased << 52) + (std::uint64_t{1023} << 52)), exponent};
}

// Natural logarithm of a positive normal number: log m = 2 artanh((m - 1) / (m + 1)).
LOCALIZATION_INLINE double log_of(double value) {
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

struct SineCosine {
  double sine, cosine;
};

// Of an angle below some 1e6: Taylor about the nearest multiple of pi / 2.
LOCALIZATION_INLINE SineCosine sine_cosine(double angle) {
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
  // By bits: the quarter tells which is which, and the signs.
  const std::uint64_t quarter = bits_of(rounded);
  const std::uint64_t swap = std::uint64_t{0} - (quarter & 1U);
  const std::uint64_t mixed = (bits_of(odd) ^ bits_of(even)) & swap;
  const std::uint64_t sine_sign = (quarter & 2U) << 62;
  const std::uint64_t cosine_sign = ((quarter + 1U) & 2U) << 62;
  return {double_of((bits_of(odd) ^ mixed) ^ sine_sign),
          double_of((bits_of(even) ^ mixed) ^ cosine_sign)};
}

}  // namespace mapperd::localization
