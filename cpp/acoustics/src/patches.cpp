#include "patches.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/acoustics/lattice.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

constexpr double kWholeCell = 0.999;  // columns: a narrower cell is one that an outline has cut
constexpr double kSmallTurn = 0.3;  // rad, by which the surface of a small object turns in a patch
constexpr double kMinSmallNodes = 8.0;  // of a patch of a small object
constexpr std::ptrdiff_t kSlopes = 12;  // numbers of G|g, see `Faces`
constexpr double kRowsApart = 0.5;      // rows between nodes along the range, at most

// The lattices' properties, before their origins are known.
struct Lattices {
  PerHit<double> projected_m2;       // of the patch on its coordinate plane; 0 beyond the rows
  PerHit<std::int64_t> normal_axis;  // of the coordinate plane most parallel to the patch
  PerHit<double> cosine, sine;       // of the turn
  PerHit<double> along_m, across_m;  // steps
  PerHit<std::int64_t> along_level, across_level, turn;
  PerHit<double> i0, j0;
};

// Properties of the hits and their faces.
struct Traits {
  PerHit<double> width_columns;
  PerHit<double> turn_per_m;
  PerHit<double> transmit_m[3], receive_m[3];  // origins
  PerHit<bool> mixed;                          // one leg has a mirror and the other has none
};

// Ranges of patches as the echo grid counts them: half of the way there and back.
struct Ranges {
  PerHit<double> near_m, far_m;  // of the corners
  PerHit<double> gradient[3];    // of the range at the middle, times the divisor
  PerHit<double> divisor;
};

// Of ways on which both legs are the seeing one, or nearly so.
MAPPERD_VECTORISED void seen_ranges(const Footprints& f, Ranges& to) {
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    double square = 0.0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto& at = f.corner_m[axis];
      const double d = 0.25 * (at[0][i] + at[1][i] + at[2][i] + at[3][i]) - f.origin_m[axis][i];
      to.gradient[axis][i] = d;
      square += d * d;
    }
    to.near_m[i] = f.near_m[i];
    to.far_m[i] = f.far_m[i];
    to.divisor[i] = std::sqrt(std::max(square, 1e-12));
  }
}

bool is_mirrored(const Leg& leg) {
  const auto& m = leg.rotation;
  return m[0] * (m[4] * m[8] - m[5] * m[7]) + m[1] * (m[5] * m[6] - m[3] * m[8]) +
             m[2] * (m[3] * m[7] - m[4] * m[6]) <
         0.0;
}

// Of ways on which one leg has a mirror and the other has none.
MAPPERD_VECTORISED void mixed_ranges(const Footprints& f, const Traits& traits, Ranges& to) {
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    double there[3], back[3], out2 = 0.0, in2 = 0.0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto& at = f.corner_m[axis];
      const double middle = 0.25 * (at[0][i] + at[1][i] + at[2][i] + at[3][i]);
      there[axis] = middle - traits.transmit_m[axis][i];
      back[axis] = middle - traits.receive_m[axis][i];
      out2 += there[axis] * there[axis];
      in2 += back[axis] * back[axis];
    }
    const double per_out = 0.5 / std::sqrt(std::max(out2, 1e-12));
    const double per_in = 0.5 / std::sqrt(std::max(in2, 1e-12));
    const bool mixed = traits.mixed[i];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double gradient = there[axis] * per_out + back[axis] * per_in;
      to.gradient[axis][i] = mixed ? gradient : to.gradient[axis][i];
    }
    to.divisor[i] = mixed ? 1.0 : to.divisor[i];
    double near_m = HUGE_VAL, far_m = 0.0;
    for (std::size_t k = 0; k < 4; ++k) {
      double transmit2 = 0.0, receive2 = 0.0;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double out = f.corner_m[axis][k][i] - traits.transmit_m[axis][i];
        const double in = f.corner_m[axis][k][i] - traits.receive_m[axis][i];
        transmit2 += out * out;
        receive2 += in * in;
      }
      const double range_m = 0.5 * (std::sqrt(transmit2) + std::sqrt(receive2));
      near_m = range_m < near_m ? range_m : near_m;
      far_m = range_m > far_m ? range_m : far_m;
    }
    to.near_m[i] = mixed ? near_m : to.near_m[i];
    to.far_m[i] = mixed ? far_m : to.far_m[i];
  }
}

// Of a vector's coordinates x, y and z, the one along the axis that follows the given one.
MAPPERD_INLINE double pick(std::int64_t axis, double x, double y, double z) {
  return axis == 2 ? x : (axis == 0 ? y : z);
}

struct Plane {
  double u, v, c;
};

// Coordinates in the plane most parallel to a patch, and along its normal axis.
MAPPERD_INLINE Plane in_plane(std::int64_t axis, double x, double y, double z) {
  return {pick(axis, x, y, z), pick(axis, y, z, x), pick(axis, z, x, y)};
}

MAPPERD_INLINE void out_of_plane(std::int64_t axis, const Plane& p, PerHit<double> (&to)[3],
                                 std::size_t i) {
  to[0][i] = axis == 2 ? p.u : (axis == 0 ? p.c : p.v);
  to[1][i] = axis == 2 ? p.v : (axis == 0 ? p.u : p.c);
  to[2][i] = axis == 2 ? p.c : (axis == 0 ? p.v : p.u);
}

// Closer along the range than across: a row is much thinner than a beam is wide, and what a cell
// hears is the more even the more of its nodes stand in line.
MAPPERD_VECTORISED void choose_lattices(const ScatterInput& echoes, const Footprints& f,
                                        const Traits& traits, const Ranges& ranges, Lattices& to,
                                        Patches& patches) {
  const double row_m = echoes.grid.row_m / echoes.grid.range_scale;
  const double end_m = row_m * static_cast<double>(echoes.grid.rows);
  const double nodes_per_cell = echoes.model.nodes_per_cell;
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    const double nx = f.normal[0][i], ny = f.normal[1][i], nz = f.normal[2][i];
    const double ax = std::fabs(nx), ay = std::fabs(ny), az = std::fabs(nz);
    const std::int64_t side = ax >= ay ? 0 : 1;
    const std::int64_t axis = az >= std::max(ax, ay) ? 2 : side;
    to.normal_axis[i] = axis;
    Plane corner[4];
    for (std::size_t k = 0; k < 4; ++k) {
      corner[k] = in_plane(axis, f.corner_m[0][k][i], f.corner_m[1][k][i], f.corner_m[2][k][i]);
    }
    const double u1 = corner[2].u - corner[0].u, v1 = corner[2].v - corner[0].v;
    const double u2 = corner[3].u - corner[1].u, v2 = corner[3].v - corner[1].v;
    const double projected_m2 = 0.5 * std::fabs(u1 * v2 - v1 * u2);
    const double near_m = ranges.near_m[i], far_m = ranges.far_m[i];
    const double covered = (std::min(far_m, end_m) - near_m) / row_m;
    to.projected_m2[i] = covered < -1.0 ? 0.0 : projected_m2;
    const double cells =
        std::max((far_m - near_m) / row_m, 1.0) * std::max(traits.width_columns[i], 1.0);
    const double wanted = nodes_per_cell * cells;
    // Few patches may be all that there is of a small object: its surface turns within one.
    const bool small = (traits.width_columns[i] < kWholeCell) |
                       (traits.turn_per_m[i] * std::sqrt(projected_m2) > kSmallTurn);
    const double nodes = small ? std::max(wanted, kMinSmallNodes) : wanted;
    const double node_m2 = projected_m2 / nodes;
    // How range grows over the lattice's plane.
    const Plane n = in_plane(axis, nx, ny, nz);
    const Plane way =
        in_plane(axis, ranges.gradient[0][i], ranges.gradient[1][i], ranges.gradient[2][i]);
    const double u = (way.u - way.c * n.u / n.c) / ranges.divisor[i];
    const double v = (way.v - way.c * n.v / n.c) / ranges.divisor[i];
    const double along_m =
        std::min(std::sqrt(node_m2), kRowsApart * row_m / std::max(std::sqrt(u * u + v * v), 1e-9));
    to.along_level[i] = level_of(along_m);
    to.along_m[i] = step_of(to.along_level[i]);
    to.across_level[i] = level_of(node_m2 / to.along_m[i]);
    to.across_m[i] = step_of(to.across_level[i]);
    to.turn[i] = turn_of(u, v);
    patches.root_area_m[i] = std::sqrt(to.along_m[i] * to.across_m[i] / std::fabs(n.c));
    patches.step_m[i] = std::max(to.along_m[i], to.across_m[i]);
  }
}

// The corners in steps of the lattices.
MAPPERD_VECTORISED void set_outlines(const Footprints& f, const Lattices& lattice, Outlines& to,
                                     Patches& patches) {
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    const std::int64_t axis = lattice.normal_axis[i];
    const double along_u = lattice.cosine[i] / lattice.along_m[i];
    const double along_v = lattice.sine[i] / lattice.along_m[i];
    const double across_u = -lattice.sine[i] / lattice.across_m[i];
    const double across_v = lattice.cosine[i] / lattice.across_m[i];
    double u[4], v[4];
    for (std::size_t k = 0; k < 4; ++k) {
      const Plane at =
          in_plane(axis, f.corner_m[0][k][i], f.corner_m[1][k][i], f.corner_m[2][k][i]);
      u[k] = at.u * along_u + at.v * along_v - lattice.i0[i];
      v[k] = at.u * across_u + at.v * across_v - lattice.j0[i];
    }
    const double low_u = std::min(std::min(u[0], u[1]), std::min(u[2], u[3]));
    const double high_u = std::max(std::max(u[0], u[1]), std::max(u[2], u[3]));
    const double low_v = std::min(std::min(v[0], v[1]), std::min(v[2], v[3]));
    const double high_v = std::max(std::max(v[0], v[1]), std::max(v[2], v[3]));
    // Long lines are quicker than many.
    const bool turned = high_v - low_v > high_u - low_u;
    double along[4], across[4];
    for (std::size_t k = 0; k < 4; ++k) {
      along[k] = turned ? v[k] : u[k];
      across[k] = turned ? u[k] : v[k];
      to.along[k][i] = along[k];
      to.across[k][i] = across[k];
    }
    for (std::size_t k = 0; k < 4; ++k) {
      const std::size_t n = (k + 1) % 4;
      to.along_per_across[k][i] = (along[n] - along[k]) / (across[n] - across[k]);
    }
    const double first_i = std::ceil(low_u);
    const double first_j = std::ceil(low_v);
    to.first_along[i] = turned ? first_j : first_i;
    to.first_across[i] = turned ? first_i : first_j;
    to.lines[i] = std::ceil(turned ? high_u : high_v) - to.first_across[i];
    to.turned[i] = turned;
    patches.first_i[i] = first_i;
    patches.first_j[i] = first_j;
  }
}

// Places on the patches' planes, relative to the transmitters.
MAPPERD_VECTORISED void locate_nodes(const Footprints& f, const Lattices& lattice,
                                     const Traits& traits, Patches& patches) {
  Linear& place = patches.place;
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    const std::int64_t axis = lattice.normal_axis[i];
    const Plane n = in_plane(axis, f.normal[0][i], f.normal[1][i], f.normal[2][i]);
    const double slope_u = n.u / n.c;
    const double slope_v = n.v / n.c;
    Plane along{lattice.along_m[i] * lattice.cosine[i], lattice.along_m[i] * lattice.sine[i], 0.0};
    Plane across{-lattice.across_m[i] * lattice.sine[i], lattice.across_m[i] * lattice.cosine[i],
                 0.0};
    along.c = -slope_u * along.u - slope_v * along.v;
    across.c = -slope_u * across.u - slope_v * across.v;
    const double shift_i = patches.first_i[i] + lattice.i0[i] - 0.5;
    const double shift_j = patches.first_j[i] + lattice.j0[i] - 0.5;
    const Plane first{shift_i * along.u + shift_j * across.u,
                      shift_i * along.v + shift_j * across.v,
                      shift_i * along.c + shift_j * across.c + f.offset[i] / n.c};
    out_of_plane(axis, along, place.along, i);
    out_of_plane(axis, across, place.across, i);
    out_of_plane(axis, first, place.first, i);
    for (std::size_t k = 0; k < 3; ++k) {
      place.first[k][i] -= traits.transmit_m[k][i];
    }
  }
}

// Normals of round surfaces there, of any length. `slopes` are the rows of G|g, see `Faces`.
MAPPERD_VECTORISED void interpolate_normals(const PerHit<double> (&slopes)[kSlopes],
                                            const Traits& traits, Patches& patches) {
  const Linear& place = patches.place;
  Linear& normal = patches.normal;
  for (std::size_t row = 0; row < 3; ++row) {
    const PerHit<double>* g = &slopes[4 * row];
    MAPPERD_INDEPENDENT
    for (std::size_t i = 0; i < kPatches; ++i) {
      const double gx = g[0][i], gy = g[1][i], gz = g[2][i];
      const double x = place.first[0][i] + traits.transmit_m[0][i];
      const double y = place.first[1][i] + traits.transmit_m[1][i];
      const double z = place.first[2][i] + traits.transmit_m[2][i];
      normal.first[row][i] = gx * x + gy * y + gz * z + g[3][i];
      normal.along[row][i] =
          gx * place.along[0][i] + gy * place.along[1][i] + gz * place.along[2][i];
      normal.across[row][i] =
          gx * place.across[0][i] + gy * place.across[1][i] + gz * place.across[2][i];
    }
  }
}

constexpr std::size_t kLinesAtOnce = 4;  // most patches have fewer lines

// One patch's sides, see `Outlines`.
struct Sides {
  double along[4], across[4], along_per_across[4];
  double first_along;
};

// Where lines cross the sides. Loops run to a multiple of the vectors' length.
MAPPERD_VECTORISED void cross(const Sides& o, double row, std::size_t count,
                              std::int32_t* __restrict first, std::int32_t* __restrict nodes) {
  for (std::size_t start = 0; start < count; start += kLinesAtOnce) {
    for (std::size_t i = start; i < start + kLinesAtOnce; ++i) {
      const double at = row + static_cast<double>(static_cast<std::int32_t>(i));
      double from = HUGE_VAL;
      double to = -HUGE_VAL;
      for (std::size_t k = 0; k < 4; ++k) {
        const double crossing = o.along[k] + (at - o.across[k]) * o.along_per_across[k];
        const bool crosses = (o.across[k] <= at) != (o.across[(k + 1) % 4] <= at);
        const double low = crosses ? crossing : HUGE_VAL;
        const double high = crosses ? crossing : -HUGE_VAL;
        from = low < from ? low : from;
        to = high > to ? high : to;
      }
      const double begin = std::ceil(from) - o.first_along;
      const double end = std::ceil(to) - o.first_along;
      const bool some = begin < end;
      first[i] = static_cast<std::int32_t>(some ? begin : 0.0);
      nodes[i] = static_cast<std::int32_t>(some ? end - begin : 0.0);
    }
  }
}

}  // namespace

void make_patches(const ScatterInput& echoes, const Footprints& footprints, Patches& patches) {
  const RayHits& hits = echoes.hits;
  Traits traits{};
  bool some_mixed = false;
  for (std::size_t i = 0; i < footprints.count; ++i) {
    const std::size_t hit = footprints.hit[i];
    const float* cell = hits.cell + 4 * hit;
    traits.width_columns[i] = static_cast<double>(cell[1] - cell[0]) / echoes.grid.sine_pitch;
    const Face& face = echoes.faces.table[hits.face[hit]];
    traits.turn_per_m[i] = face.turn_per_m;
    if (face.smooth >= 0) {
      const double* slopes = echoes.faces.curved_normal + kSlopes * face.smooth;
      __builtin_prefetch(slopes);
      __builtin_prefetch(slopes + kSlopes - 1);
    }
    const Leg& transmit = hits.legs[hits.transmit[hit]];
    const Leg& receive = hits.legs[hits.receive[hit]];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      traits.transmit_m[axis][i] = transmit.origin_m[axis];
      traits.receive_m[axis][i] = receive.origin_m[axis];
    }
    traits.mixed[i] = &transmit != &receive && is_mirrored(transmit) != is_mirrored(receive);
    some_mixed |= traits.mixed[i];
  }
  Ranges ranges;
  seen_ranges(footprints, ranges);
  if (some_mixed) {
    mixed_ranges(footprints, traits, ranges);
  }
  Lattices lattices{};
  choose_lattices(echoes, footprints, traits, ranges, lattices, patches);
  for (std::size_t i = 0; i < kPatches; ++i) {
    patches.exists[i] =
        i < footprints.count && footprints.exists[i] && lattices.projected_m2[i] > 0.0;
    if (patches.exists[i]) {
      const Face& face = echoes.faces.table[hits.face[footprints.hit[i]]];
      const auto& n = footprints.normal;
      const std::int64_t facing = face.smooth < 0 ? 0 : facing_of(n[0][i], n[1][i], n[2][i]);
      const LatticeOrigin origin = origin_of(echoes.model.key, face.object,
                                             {lattices.normal_axis[i], lattices.along_level[i],
                                              lattices.across_level[i], lattices.turn[i], facing});
      patches.key[i] = origin.key;
      lattices.i0[i] = origin.i0;
      lattices.j0[i] = origin.j0;
      lattices.cosine[i] = kCosine[lattices.turn[i]];
      lattices.sine[i] = kSine[lattices.turn[i]];
    }
  }
  set_outlines(footprints, lattices, patches.outline, patches);
  locate_nodes(footprints, lattices, traits, patches);
  PerHit<double> slopes[kSlopes]{};
  bool round = false;
  for (std::size_t i = 0; i < footprints.count; ++i) {
    const std::int32_t smooth = echoes.faces.table[hits.face[footprints.hit[i]]].smooth;
    if (smooth >= 0) {
      const double* from = echoes.faces.curved_normal + kSlopes * smooth;
      for (std::ptrdiff_t k = 0; k < kSlopes; ++k) {
        slopes[k][i] = from[k];
      }
      round = true;
    }
  }
  if (round) {
    interpolate_normals(slopes, traits, patches);
  }
}

void scan(const Outlines& outlines, std::size_t patch, std::size_t from, Lines& lines) {
  Sides sides;
  for (std::size_t k = 0; k < 4; ++k) {
    sides.along[k] = outlines.along[k][patch];
    sides.across[k] = outlines.across[k][patch];
    sides.along_per_across[k] = outlines.along_per_across[k][patch];
  }
  sides.first_along = outlines.first_along[patch];
  lines.size = std::min(static_cast<std::size_t>(outlines.lines[patch]) - from, kLines);
  cross(sides, outlines.first_across[patch] + static_cast<double>(from), lines.size, lines.first,
        lines.count);
}

}  // namespace mapperd::acoustics
