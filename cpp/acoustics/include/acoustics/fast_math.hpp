// Elementary functions as short series without branches, so that loops over them become vector
// code; the same operations in the same order everywhere give the same bits everywhere.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

// Loops marked so are compiled twice, with and without AVX2, and chosen between when loaded.
// Sanitizers do not work in such a choice, and other compilers do not know it.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define ACOUSTICS_VECTORISED __attribute__((target_clones("avx2", "default")))
#else
#define ACOUSTICS_VECTORISED
#endif
#if defined(__GNUC__)
#define ACOUSTICS_INLINE inline __attribute__((always_inline))
#else
#define ACOUSTICS_INLINE inline
#endif

namespace acoustics {

ACOUSTICS_INLINE std::int32_t bits_of(float value) {
  std::int32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

ACOUSTICS_INLINE float float_of(std::int32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

// Natural logarithm of a normal positive number, to some 2e-7 absolutely.
// The mantissa is taken from [sqrt(1/2), sqrt(2)); log m = 2 artanh((m - 1) / (m + 1)).
ACOUSTICS_INLINE float fast_log(float value) {
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

// 2 to a power between -126 and 126, to some 2e-7 relatively: Taylor about the nearest integer.
ACOUSTICS_INLINE float fast_exp2(float power) {
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

// base^power for 0 <= base < 1e38 and |power| <= 2; bases under 1e-37 count as 0.
ACOUSTICS_INLINE float fast_power(float base, float power) {
  // By bits, for a choice would become a branch.
  const std::int32_t some = -static_cast<std::int32_t>(base > 1e-37F);
  const float raised = fast_exp2(power * 1.44269504F * fast_log(base > 1e-37F ? base : 1e-37F));
  return float_of(bits_of(raised) & some);
}

// Cosine and sine for 0 <= angle <= pi/4, by Taylor.
ACOUSTICS_INLINE float octant_cos(float angle) {
  const float x2 = angle * angle;
  return 1.0F + x2 * (-0.5F + x2 * (1.0F / 24 + x2 * (-1.0F / 720 + x2 * (1.0F / 40320))));
}

ACOUSTICS_INLINE float octant_sin(float angle) {
  const float x2 = angle * angle;
  return angle * (1.0F + x2 * (-1.0F / 6 + x2 * (1.0F / 120 + x2 * (-1.0F / 5040))));
}

}  // namespace acoustics
