// The lattice of scatterers on a face's plane: fixed to the object, whatever its triangles.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "acoustics/footprint.hpp"
#include "acoustics/random.hpp"

namespace acoustics {

// Axes of the plane that faces a patch most (u, v) and the one across it (c).
struct Axes {
  std::size_t u, v, c;
};

inline Axes axes_of(const Vector& normal) {
  const double x = std::fabs(normal[0]);
  const double y = std::fabs(normal[1]);
  const double z = std::fabs(normal[2]);
  if (z >= x && z >= y) {
    return {0, 1, 2};
  }
  return x >= y ? Axes{1, 2, 0} : Axes{2, 0, 1};
}

// Steps of the lattice are powers of 2^(1/4) m, so that near and far pings share their scatterers.
inline int level_of(double step_m) {
  return static_cast<int>(std::floor(4.0 * std::log2(std::clamp(step_m, 1e-5, 1e3))));
}

inline double step_of(int level) { return std::exp2(0.25 * level); }

// Area of a patch's shadow on its lattice's plane.
inline double shadow_m2(const std::array<Vector, 4>& corner, const Axes& axes) {
  const double u1 = corner[2][axes.u] - corner[0][axes.u];
  const double v1 = corner[2][axes.v] - corner[0][axes.v];
  const double u2 = corner[3][axes.u] - corner[1][axes.u];
  const double v2 = corner[3][axes.v] - corner[1][axes.v];
  return 0.5 * std::fabs(u1 * v2 - v1 * u2);
}

// A lattice turned within its plane: nodes at (i + i0) along_m and (j + j0) across_m.
struct Lattice {
  std::uint64_t key;  // its nodes' keys follow from their indices
  double along_m, across_m;
  double cosine, sine;  // of the turn
  double i0, j0;
};

// Calls visit(i, j) for each node of a lattice inside a convex quadrangle; patches that share an
// edge share no node.
template <typename Visit>
void scan_nodes(const std::array<Vector, 4>& corner, const Axes& axes, const Lattice& lattice,
                Visit&& visit) {
  const double along_u = lattice.cosine / lattice.along_m;
  const double along_v = lattice.sine / lattice.along_m;
  const double across_u = -lattice.sine / lattice.across_m;
  const double across_v = lattice.cosine / lattice.across_m;
  double u[4];
  double v[4];
  for (std::size_t k = 0; k < 4; ++k) {
    const double at_u = corner[k][axes.u];
    const double at_v = corner[k][axes.v];
    u[k] = at_u * along_u + at_v * along_v - lattice.i0;
    v[k] = at_u * across_u + at_v * across_v - lattice.j0;
  }
  // Long rows are quicker than many.
  const double wide = *std::max_element(u, u + 4) - *std::min_element(u, u + 4);
  const double high = *std::max_element(v, v + 4) - *std::min_element(v, v + 4);
  const bool turned = high > wide;
  const double* along = turned ? v : u;
  const double* across = turned ? u : v;
  const double top = std::ceil(*std::max_element(across, across + 4));
  for (double row = std::ceil(*std::min_element(across, across + 4)); row < top; row += 1.0) {
    double from = HUGE_VAL;
    double to = -HUGE_VAL;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::size_t n = (k + 1) % 4;
      if ((across[k] <= row) != (across[n] <= row)) {
        const double crossing =
            along[k] + (row - across[k]) * (along[n] - along[k]) / (across[n] - across[k]);
        from = std::min(from, crossing);
        to = std::max(to, crossing);
      }
    }
    for (double at = std::ceil(from); at < to; at += 1.0) {
      turned ? visit(row, at) : visit(at, row);
    }
  }
}

// Which lattice a patch has. Turns go in eighths of a half turn: long before a sonar has gone so
// far around a patch its speckle is another one anyway.
struct LatticeName {
  Axes axes;
  int along_level, across_level;
  int turn;
};

constexpr int kTurns = 8;

// Its origin is random: a scene's symmetry must not decide how many nodes a patch has.
inline Lattice lattice_of(std::uint64_t key, std::uint32_t object, const LatticeName& name) {
  const auto word = [](int value) {
    return static_cast<std::uint64_t>(static_cast<std::uint32_t>(value) & 0xFFFFU);
  };
  const std::uint64_t names = word(name.along_level) << 32 | word(name.across_level) << 16 |
                              word(name.turn) << 2 | name.axes.c;
  const std::uint64_t own = joined(joined(key, object), names);
  const std::uint64_t origin = mix(own);
  const double angle = 3.14159265358979323846 / kTurns * name.turn;
  return {own,
          step_of(name.along_level),
          step_of(name.across_level),
          std::cos(angle),
          std::sin(angle),
          static_cast<double>(origin & 0xFFFFU) * 0x1p-16,
          static_cast<double>(origin >> 16 & 0xFFFFU) * 0x1p-16};
}

inline std::uint64_t node_key(std::uint64_t lattice, double i, double j) {
  const auto column = static_cast<std::uint64_t>(static_cast<std::int64_t>(i));
  const auto row = static_cast<std::uint64_t>(static_cast<std::int64_t>(j));
  return mix(lattice + column * 0xD1B54A32D192ED03ULL + row * 0x8CB92BA72F3D8DD7ULL);
}

}  // namespace acoustics
