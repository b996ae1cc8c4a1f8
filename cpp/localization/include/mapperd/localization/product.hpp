/// \file
/// \brief Products of many densities that neither under- nor overflow.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/draws.hpp"

namespace mapperd::localization {

inline constexpr std::size_t kFactors = 8;  ///< multiplied before the exponent is split off

/// One product per particle of a block: mantissa * 2^exponent. Factors must lie within 1e-30 ...
/// 1e30.
struct Products {
  double mantissa[kBlock];
  double exponent[kBlock];

  MAPPERD_INLINE void start() {
    for (std::size_t i = 0; i < kBlock; ++i) {
      mantissa[i] = 1.0;
      exponent[i] = 0.0;
    }
  }
  MAPPERD_INLINE void split_off() {
    for (std::size_t i = 0; i < kBlock; ++i) {
      const Split parts = split(mantissa[i]);
      mantissa[i] = parts.mantissa;
      exponent[i] += parts.exponent;
    }
  }
  MAPPERD_INLINE void logs(double factor, double* out) const {
    for (std::size_t i = 0; i < kBlock; ++i) {
      out[i] = factor * (fast_log(mantissa[i]) + exponent[i] * 0.69314718055994530942);
    }
  }
};

}  // namespace mapperd::localization
