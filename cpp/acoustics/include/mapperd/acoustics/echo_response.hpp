/// \file
/// \brief A point relative to a leg, its vertical pattern, and the columns over which an echo
/// spreads.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "mapperd/acoustics/bands.hpp"
#include "mapperd/acoustics/footprint.hpp"

namespace mapperd::acoustics {

/// One-way pressure of the vertical pattern.
inline float vertical_at(const EchoResponse& response, double w) {
  const auto last = static_cast<double>(response.vertical_count - 1);
  const double at = std::min(std::fabs(w), 1.0) * last;
  const auto below = std::min(static_cast<std::size_t>(at), response.vertical_count - 2);
  const auto part = static_cast<float>(at - static_cast<double>(below));
  return response.vertical[below] +
         part * (response.vertical[below + 1] - response.vertical[below]);
}

/// A point relative to a leg.
struct PolarPoint {
  double range_m, s, w;
  Vec3 direction;  ///< object's frame
};

inline PolarPoint polar_point(const Leg& leg, const Vec3& point_m) {
  const Vec3 d = point_m - leg.origin_m;
  const double range_m = std::sqrt(std::max(dot(d, d), 1e-12));
  const double part = 1.0 / range_m;
  const auto& m = leg.rotation;
  return {range_m, -(m[1] * d.x + m[4] * d.y + m[7] * d.z) * part,
          (m[2] * d.x + m[5] * d.y + m[8] * d.z) * part, part * d};
}

/// Columns over which an echo between columns spreads.
struct Spread {
  std::ptrdiff_t column;
  std::size_t fraction;
};

inline Spread spread_at(const EchoResponse& response, double column) {
  const double whole = std::floor(column);
  const auto fractions = static_cast<double>(response.fractions);
  const auto fraction =
      std::min(static_cast<std::size_t>((column - whole) * fractions), response.fractions - 1);
  const auto before = static_cast<std::ptrdiff_t>(response.tap_count / 2) - 1;
  return {static_cast<std::ptrdiff_t>(whole) - before, fraction};
}

}  // namespace mapperd::acoustics
