/// \file
/// \brief The lattice of scatterers on a face's plane, fixed to the object and independent of its
/// triangles.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/complex_gaussian.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

/// Steps of the lattice are powers of 2^(1/4) m, so that near and far pings share their scatterers.
/// Returns floor(4 log2 step_m) of a step limited to 1e-5 m .. 1e3 m.
MAPPERD_INLINE std::int64_t level_of(double step_m) {
  constexpr double kQuarters[3] = {1.1892071150027210, 1.4142135623730951, 1.6817928305074290};
  const double at_least = step_m < 1e-5 ? 1e-5 : step_m;
  const double step = at_least > 1e3 ? 1e3 : at_least;
  const std::uint64_t bits = bits_of(step);
  const auto exponent = static_cast<std::int64_t>(bits >> 52) - 1023;
  const double mantissa = double_of((bits & 0xFFFFFFFFFFFFFULL) | 0x3FF0000000000000ULL);
  return 4 * exponent + (mantissa >= kQuarters[0] ? 1 : 0) + (mantissa >= kQuarters[1] ? 1 : 0) +
         (mantissa >= kQuarters[2] ? 1 : 0);
}

MAPPERD_INLINE double step_of(std::int64_t level) {
  const auto quarters = static_cast<std::uint64_t>(level + 4 * 1023);
  const double power = double_of((quarters >> 2) << 52);
  const std::uint64_t part = quarters & 3U;
  const double half = part >= 2 ? 1.4142135623730951 : 1.0;
  const double quarter = part == 1 ? 1.1892071150027210 : 1.6817928305074290;
  return power * ((part & 1U) != 0 ? quarter : half);
}

/// Identity of a lattice on a plane: nodes at (i + i0) steps along and (j + j0) steps across,
/// turned in the coordinate plane most parallel to it. Rotations are in eighths of a half turn:
/// long before a sonar has moved that far around a patch its speckle has changed anyway.
struct LatticeId {
  std::int64_t normal_axis;
  std::int64_t along_level, across_level;
  std::int64_t turn;
  std::int64_t facing;  ///< see `facing_of`; 0 where a surface is flat
};

/// Direction of a normal in coarse steps, more than 0. The planes of a round surface's faces
/// overlap beyond the faces: with the same nodes there, one echo would be heard twice, in phase.
inline std::int64_t facing_of(double x, double y, double z) {
  constexpr double kSteps = 6.0;
  const auto step = [](double part) {
    return static_cast<std::int64_t>(kSteps * (part + 1.0) + 0.5);
  };
  return 1 + step(x) + 16 * step(y) + 256 * step(z);
}

constexpr std::int64_t kTurns = 8;

/// Cosines and sines of the rotations.
constexpr double kCosine[kTurns] = {
    1.0, 0.92387953251128674,  0.70710678118654752,  0.38268343236508977,
    0.0, -0.38268343236508977, -0.70710678118654752, -0.92387953251128674};
constexpr double kSine[kTurns] = {
    0.0, 0.38268343236508977, 0.70710678118654752, 0.92387953251128674,
    1.0, 0.92387953251128674, 0.70710678118654752, 0.38268343236508977};

/// Rotation nearest to a direction or its opposite.
MAPPERD_INLINE std::int64_t turn_of(double u, double v) {
  constexpr double kTangent[4] = {0.19891236737965800, 0.66817863791929891, 1.4966057626654890,
                                  5.0273394921258481};  // of 1, 3, 5 and 7 halves of a turn
  const double across = std::fabs(v);
  const double along = std::fabs(u);
  std::int64_t turn = 0;
  for (const double tangent : kTangent) {
    turn += across > tangent * along ? 1 : 0;
  }
  const std::int64_t negative = (kTurns - turn) & (kTurns - 1);
  return (u < 0.0) != (v < 0.0) ? negative : turn;
}

/// Where a lattice begins, at random, so that a scene's symmetry does not affect the number of
/// nodes; and the key from which its nodes' keys follow.
struct LatticeOrigin {
  std::uint64_t key;
  double i0, j0;
};

inline LatticeOrigin origin_of(std::uint64_t key, std::uint32_t object, const LatticeId& name) {
  const auto word = [](std::int64_t value) { return static_cast<std::uint64_t>(value) & 0xFFFFU; };
  const std::uint64_t names = word(name.facing) << 48 | word(name.along_level) << 32 |
                              word(name.across_level) << 16 | word(name.turn) << 2 |
                              word(name.normal_axis);
  const std::uint64_t own = joined(joined(key, object), names);
  const std::uint64_t origin = mix(own);
  return {own, static_cast<double>(origin & 0xFFFFU) * 0x1p-16,
          static_cast<double>(origin >> 16 & 0xFFFFU) * 0x1p-16};
}

/// Random bits of a lattice's node (i, j): the first for its position, the second for its echo.
struct NodeBits {
  std::uint32_t place, echo;
};

/// Mixes all bits of a number (Wellons 2018, "Prospecting for hash functions", lowbias32).
MAPPERD_INLINE std::uint32_t mix32(std::uint32_t number) {
  number = (number ^ (number >> 16)) * 0x7FEB352DU;
  number = (number ^ (number >> 15)) * 0x846CA68BU;
  return number ^ (number >> 16);
}

/// `low` and `high` are the halves of the lattice's key. Nodes with equal bits are tens of
/// thousands of steps apart.
MAPPERD_INLINE NodeBits node_bits(std::uint32_t low, std::uint32_t high, std::uint32_t i,
                                  std::uint32_t j) {
  const std::uint32_t place = mix32(low + i * 0xD192ED03U + j * 0x2F3D8DD7U);
  return {place, mix32(place ^ high)};
}

}  // namespace mapperd::acoustics
