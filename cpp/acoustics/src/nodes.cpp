#include "nodes.hpp"

#include <algorithm>
#include <cmath>

#include "acoustics/fast_math.hpp"

namespace acoustics {

namespace {

// Numbers a vector loop works on at once: loops run to a multiple of it, over what nobody reads.
constexpr std::size_t kLanes = 8;

ACOUSTICS_VECTORISED void place(const PatchLaws& patch, Nodes& nodes, std::size_t count) {
  const Lattice& lattice = patch.lattice;
  const double u_shift = lattice.i0 - 0.5;
  const double v_shift = lattice.j0 - 0.5;
  const double along_u = lattice.along_m * lattice.cosine;
  const double along_v = lattice.along_m * lattice.sine;
  const double across_u = -lattice.across_m * lattice.sine;
  const double across_v = lattice.across_m * lattice.cosine;
  const Vector& n = patch.normal;
  const double slope_u = n[patch.axes.u] / n[patch.axes.c];
  const double slope_v = n[patch.axes.v] / n[patch.axes.c];
  const double height_m = patch.offset / n[patch.axes.c];
  double* to_u = nodes.point_m[patch.axes.u];
  double* to_v = nodes.point_m[patch.axes.v];
  double* to_c = nodes.point_m[patch.axes.c];
  for (std::size_t i = 0; i < count; ++i) {
    const double along = nodes.u[i] + u_shift;
    const double across = nodes.v[i] + v_shift;
    const double u = along * along_u + across * across_u;
    const double v = along * along_v + across * across_v;
    to_u[i] = u;
    to_v[i] = v;
    to_c[i] = height_m - slope_u * u - slope_v * v;
  }
}

ACOUSTICS_VECTORISED void look(const Leg& leg, const Nodes& nodes, std::size_t count, Sights& to) {
  const double o[3] = {leg.origin_m[0], leg.origin_m[1], leg.origin_m[2]};
  const double m1 = leg.rotation[1], m4 = leg.rotation[4], m7 = leg.rotation[7];
  const double m2 = leg.rotation[2], m5 = leg.rotation[5], m8 = leg.rotation[8];
  for (std::size_t i = 0; i < count; ++i) {
    const double x = nodes.point_m[0][i] - o[0];
    const double y = nodes.point_m[1][i] - o[1];
    const double z = nodes.point_m[2][i] - o[2];
    const double range_m = std::sqrt(x * x + y * y + z * z + 1e-12);
    const double part = 1.0 / range_m;
    const double dx = x * part;
    const double dy = y * part;
    const double dz = z * part;
    to.range_m[i] = range_m;
    to.way[0][i] = dx;
    to.way[1][i] = dy;
    to.way[2][i] = dz;
    to.s[i] = static_cast<float>(-(m1 * dx + m4 * dy + m7 * dz));
    to.w[i] = static_cast<float>(m2 * dx + m5 * dy + m8 * dz);
  }
}

// Cosines of incidence on the patch's plane.
ACOUSTICS_VECTORISED void flat_cosines(double height_m, const Sights& from, std::size_t count,
                                       float* cosine) {
  for (std::size_t i = 0; i < count; ++i) {
    cosine[i] = static_cast<float>(height_m / from.range_m[i]);
  }
}

// Cosines on the round surface that the plane stands for, and the area seen over the plane's.
ACOUSTICS_VECTORISED void bent_cosines(const PatchLaws& patch, const Nodes& nodes,
                                       const Sights& out, const Sights& back, std::size_t count,
                                       float (*cosine)[kNodes], float* area) {
  const double* g = patch.bent;
  const double height_m = patch.transmit_height_m;
  for (std::size_t i = 0; i < count; ++i) {
    const double x = nodes.point_m[0][i];
    const double y = nodes.point_m[1][i];
    const double z = nodes.point_m[2][i];
    const double nx = g[0] * x + g[1] * y + g[2] * z + g[3];
    const double ny = g[4] * x + g[5] * y + g[6] * z + g[7];
    const double nz = g[8] * x + g[9] * y + g[10] * z + g[11];
    const double part = 1.0 / std::sqrt(nx * nx + ny * ny + nz * nz + 1e-30);
    const double there = nx * out.way[0][i] + ny * out.way[1][i] + nz * out.way[2][i];
    const double here = nx * back.way[0][i] + ny * back.way[1][i] + nz * back.way[2][i];
    const double transmit = std::fabs(there) * part;
    const double hx = out.way[0][i] + back.way[0][i];
    const double hy = out.way[1][i] + back.way[1][i];
    const double hz = out.way[2][i] + back.way[2][i];
    const double half = 1.0 / std::sqrt(hx * hx + hy * hy + hz * hz + 1e-12);
    cosine[0][i] = static_cast<float>(transmit);
    cosine[1][i] = static_cast<float>(std::fabs(here) * part);
    cosine[2][i] = static_cast<float>(std::fabs(there + here) * part * half);
    const double least = transmit > kLeastCosine ? transmit : kLeastCosine;
    area[i] = static_cast<float>(height_m / out.range_m[i] / least);
  }
}

// Cosine of the half-way direction with the plane's normal.
ACOUSTICS_VECTORISED void half_cosines(const Vector& n, const Sights& out, const Sights& back,
                                       std::size_t count, float* cosine) {
  const double nx = n[0], ny = n[1], nz = n[2];
  for (std::size_t i = 0; i < count; ++i) {
    const double hx = out.way[0][i] + back.way[0][i];
    const double hy = out.way[1][i] + back.way[1][i];
    const double hz = out.way[2][i] + back.way[2][i];
    const double part = 1.0 / std::sqrt(hx * hx + hy * hy + hz * hz + 1e-12);
    cosine[i] = static_cast<float>(std::fabs(nx * hx + ny * hy + nz * hz) * part);
  }
}

// Phase, row, column, and the pressure that is left by spreading.
ACOUSTICS_VECTORISED void hear(const Echoes& e, const PatchLaws& patch, const Sights& out,
                               const Sights& back, std::size_t count, const float* section,
                               HeardNodes& to) {
  const EchoGrid& grid = e.grid;
  const double scale = 0.5 * grid.range_scale / grid.row_m;
  const double rows_per_m = 1.0 / grid.row_m;
  const double d0 = patch.receive->drift_m[0] * rows_per_m;
  const double d1 = patch.receive->drift_m[1] * rows_per_m;
  const double d2 = patch.receive->drift_m[2] * rows_per_m;
  const auto last_row = static_cast<double>(grid.rows - 1);
  const double turns_per_m = e.laws.turns_per_m;
  const auto first_sine = static_cast<float>(grid.first_sine);
  const auto columns_per_sine = static_cast<float>(1.0 / grid.sine_pitch);
  const bool spreading = e.laws.spreading;
  const float gain = patch.gain;
  for (std::size_t i = 0; i < count; ++i) {
    const double both_m = out.range_m[i] + back.range_m[i];
    const double drift = d0 * out.way[0][i] + d1 * out.way[1][i] + d2 * out.way[2][i];
    const double at = scale * both_m + drift;
    // Beyond the grid on either side: one row that does not exist.
    const double within = at < 0.0 ? -1.0 : (at > last_row + 1.0 ? last_row + 1.0 : at);
    to.row[i] = static_cast<std::int32_t>(within + 1.0) - 1;
    const double turns = both_m * turns_per_m;
    to.turns[i] = static_cast<float>(turns - static_cast<double>(static_cast<std::int32_t>(turns)));
    to.column[i] = (back.s[i] - first_sine) * columns_per_sine;
    const double spread = out.range_m[i] * back.range_m[i];
    const double part = spreading ? 1.0 / spread : 1.0;
    to.pressure[i] = static_cast<float>(part) * (gain * std::sqrt(section[i]));
  }
}

// One-way pressure of the vertical pattern.
ACOUSTICS_VECTORISED void pattern(const Hearing& response, const float* __restrict w,
                                  std::size_t count, float* __restrict to) {
  const float* __restrict vertical = response.vertical;
  const auto last = static_cast<float>(response.vertical_count - 1);
  const auto below_last = static_cast<std::int32_t>(response.vertical_count - 2);
  for (std::size_t i = 0; i < count; ++i) {
    const float at = std::fabs(w[i]) * last;
    const auto low = static_cast<std::int32_t>(at);
    const std::int32_t below = low < below_last ? low : below_last;
    const float value = vertical[below];
    to[i] = value + (at - static_cast<float>(below)) * (vertical[below + 1] - value);
  }
}

ACOUSTICS_VECTORISED void weigh(const float* __restrict there, const float* __restrict here,
                                const float* __restrict loss, const std::int32_t* __restrict row,
                                std::int32_t rows, std::size_t count, float* __restrict pressure) {
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t from = row[i] > 0 ? row[i] : 0;
    pressure[i] *= there[i] * here[i] * loss[from < rows ? from : rows - 1];
  }
}

}  // namespace

const HeardNodes& NodeWorks::heard(const PatchLaws& patch, const Strength& strength, Nodes& nodes) {
  const std::size_t count = std::min((nodes.count + kLanes - 1) / kLanes * kLanes, kNodes);
  for (std::size_t i = nodes.count; i < count; ++i) {
    nodes.u[i] = nodes.u[nodes.count - 1];
    nodes.v[i] = nodes.v[nodes.count - 1];
  }
  place(patch, nodes, count);
  look(*patch.transmit, nodes, count, out_);
  const bool same = patch.transmit == patch.receive;
  if (!same) {
    look(*patch.receive, nodes, count, back_);
  }
  const Sights& back = same ? out_ : back_;
  if (patch.bent != nullptr) {
    bent_cosines(patch, nodes, out_, back, count, cosine_, section_);
    strength.times(cosine_[0], cosine_[1], cosine_[2], count, section_);
  } else {
    flat_cosines(patch.transmit_height_m, out_, count, cosine_[0]);
    flat_cosines(patch.receive_height_m, back, count, cosine_[1]);
    std::fill(section_, section_ + count, 1.0F);
    const bool aside = strength.has_lobe() && !same;
    if (aside) {
      half_cosines(patch.normal, out_, back, count, cosine_[2]);
    }
    strength.times(cosine_[0], cosine_[1], cosine_[aside ? 2 : 0], count, section_);
  }
  hear(e_, patch, out_, back, count, section_, heard_);
  pattern(e_.response, out_.w, count, there_);
  if (!same) {
    pattern(e_.response, back_.w, count, here_);
  }
  weigh(there_, same ? there_ : here_, e_.response.loss, heard_.row,
        static_cast<std::int32_t>(e_.grid.rows), count, heard_.pressure);
  return heard_;
}

}  // namespace acoustics
