/// \file
/// \brief The lattice of scatterers on a face's plane, fixed to the object and independent of its
/// triangles.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "mapperd/acoustics/complex_gaussian.hpp"
#include "mapperd/acoustics/footprint.hpp"

namespace mapperd::acoustics {

/// Axes of the coordinate plane most parallel to a patch (u, v), and its normal axis (c).
struct Axes {
  std::size_t u, v, c;
};

inline Axes axes_of(const Vec3& normal) {
  const double x = std::fabs(normal[0]);
  const double y = std::fabs(normal[1]);
  const double z = std::fabs(normal[2]);
  if (z >= x && z >= y) {
    return {0, 1, 2};
  }
  return x >= y ? Axes{1, 2, 0} : Axes{2, 0, 1};
}

/// Steps of the lattice are powers of 2^(1/4) m, so that near and far pings share their scatterers.
/// Returns floor(4 log2 step_m) of a step limited to 1e-5 m .. 1e3 m.
inline int level_of(double step_m) {
  constexpr double kQuarters[3] = {1.1892071150027210, 1.4142135623730951, 1.6817928305074290};
  const double step = std::clamp(step_m, 1e-5, 1e3);
  std::uint64_t bits = 0;
  std::memcpy(&bits, &step, sizeof bits);
  const int exponent = static_cast<int>(bits >> 52) - 1023;
  bits = (bits & 0xFFFFFFFFFFFFFULL) | 0x3FF0000000000000ULL;
  double mantissa = 0.0;
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  return 4 * exponent + static_cast<int>(mantissa >= kQuarters[0]) +
         static_cast<int>(mantissa >= kQuarters[1]) + static_cast<int>(mantissa >= kQuarters[2]);
}

inline double step_of(int level) {
  constexpr double kPart[4] = {1.0, 1.1892071150027210, 1.4142135623730951, 1.6817928305074290};
  const std::uint64_t bits = static_cast<std::uint64_t>((level >> 2) + 1023) << 52;
  double power = 0.0;
  std::memcpy(&power, &bits, sizeof power);
  return power * kPart[level & 3];
}

/// Area of a patch's shadow on its lattice's plane.
inline double shadow_m2(const Corners& corner, const Axes& axes) {
  const double u1 = corner[axes.u][2] - corner[axes.u][0];
  const double v1 = corner[axes.v][2] - corner[axes.v][0];
  const double u2 = corner[axes.u][3] - corner[axes.u][1];
  const double v2 = corner[axes.v][3] - corner[axes.v][1];
  return 0.5 * std::fabs(u1 * v2 - v1 * u2);
}

/// A lattice rotated in its plane: nodes at (i + i0) along_m and (j + j0) across_m.
struct Lattice {
  std::uint64_t key;  ///< its nodes' keys follow from their indices
  double along_m, across_m;
  double cosine, sine;  ///< of the turn
  double i0, j0;
};

/// Identity of a patch's lattice. Rotations are in eighths of a half turn: long before a sonar has
/// moved that far around a patch its speckle has changed anyway.
struct LatticeName {
  Axes axes;
  int along_level, across_level;
  int turn;
};

constexpr int kTurns = 8;

/// Cosines and sines of the rotations.
constexpr double kCosine[kTurns] = {
    1.0, 0.92387953251128674,  0.70710678118654752,  0.38268343236508977,
    0.0, -0.38268343236508977, -0.70710678118654752, -0.92387953251128674};
constexpr double kSine[kTurns] = {
    0.0, 0.38268343236508977, 0.70710678118654752, 0.92387953251128674,
    1.0, 0.92387953251128674, 0.70710678118654752, 0.38268343236508977};

/// Rotation nearest to a direction or its opposite.
inline int turn_of(double u, double v) {
  constexpr double kTangent[4] = {0.19891236737965800, 0.66817863791929891, 1.4966057626654890,
                                  5.0273394921258481};  // of 1, 3, 5 and 7 halves of a turn
  const double across = std::fabs(v);
  const double along = std::fabs(u);
  int turn = 0;
  for (const double tangent : kTangent) {
    turn += static_cast<int>(across > tangent * along);
  }
  return (u < 0.0) != (v < 0.0) ? (kTurns - turn) & (kTurns - 1) : turn;
}

/// The origin is random, so that a scene's symmetry does not affect the number of nodes.
inline Lattice lattice_of(std::uint64_t key, std::uint32_t object, const LatticeName& name) {
  const auto word = [](int value) {
    return static_cast<std::uint64_t>(static_cast<std::uint32_t>(value) & 0xFFFFU);
  };
  const std::uint64_t names = word(name.along_level) << 32 | word(name.across_level) << 16 |
                              word(name.turn) << 2 | name.axes.c;
  const std::uint64_t own = joined(joined(key, object), names);
  const std::uint64_t origin = mix(own);
  return {own,
          step_of(name.along_level),
          step_of(name.across_level),
          kCosine[name.turn],
          kSine[name.turn],
          static_cast<double>(origin & 0xFFFFU) * 0x1p-16,
          static_cast<double>(origin >> 16 & 0xFFFFU) * 0x1p-16};
}

/// Random bits of a lattice's node (i, j): the first for its position, the second for its echo.
struct NodeBits {
  std::uint32_t place, echo;
};

/// Mixes all bits of a number (Wellons 2018, "Prospecting for hash functions", lowbias32).
MAPPERD_INLINE std::uint32_t stirred(std::uint32_t number) {
  number = (number ^ (number >> 16)) * 0x7FEB352DU;
  number = (number ^ (number >> 15)) * 0x846CA68BU;
  return number ^ (number >> 16);
}

/// `low` and `high` are the halves of the lattice's key. Nodes with equal bits are tens of
/// thousands of steps apart.
MAPPERD_INLINE NodeBits node_bits(std::uint32_t low, std::uint32_t high, std::uint32_t i,
                                  std::uint32_t j) {
  const std::uint32_t place = stirred(low + i * 0xD192ED03U + j * 0x2F3D8DD7U);
  return {place, stirred(place ^ high)};
}

}  // namespace mapperd::acoustics
