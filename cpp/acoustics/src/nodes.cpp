#include "nodes.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

MAPPERD_VECTORISED void look(const Leg& leg, const Nodes& nodes, std::size_t count, Sights& to) {
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

// Cosines of incidence on a plane.
MAPPERD_VECTORISED void flat_cosines(const float* height_m, const Sights& from, std::size_t count,
                                     float* cosine) {
  for (std::size_t i = 0; i < count; ++i) {
    cosine[i] = height_m[i] / static_cast<float>(from.range_m[i]);
  }
}

// Cosines on the round surface that the plane stands for, and the area seen over the plane's.
MAPPERD_VECTORISED void round_cosines(const Nodes& nodes, const Sights& out, const Sights& back,
                                      Each<float>* cosine, float* area) {
  constexpr auto kLeast = static_cast<float>(kMinCosine);
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const auto nx = static_cast<float>(nodes.normal[0][i]);
    const auto ny = static_cast<float>(nodes.normal[1][i]);
    const auto nz = static_cast<float>(nodes.normal[2][i]);
    const auto ox = static_cast<float>(out.way[0][i]);
    const auto oy = static_cast<float>(out.way[1][i]);
    const auto oz = static_cast<float>(out.way[2][i]);
    const auto bx = static_cast<float>(back.way[0][i]);
    const auto by = static_cast<float>(back.way[1][i]);
    const auto bz = static_cast<float>(back.way[2][i]);
    const float part = 1.0F / std::sqrt(nx * nx + ny * ny + nz * nz + 1e-30F);
    const float transmit = std::fabs(nx * ox + ny * oy + nz * oz) * part;
    cosine[0][i] = transmit;
    cosine[1][i] = std::fabs(nx * bx + ny * by + nz * bz) * part;
    const float least = transmit > kLeast ? transmit : kLeast;
    area[i] = nodes.height_m[0][i] / (static_cast<float>(out.range_m[i]) * least);
  }
}

// Cosine of the half-way direction with the surface's normal.
MAPPERD_VECTORISED void half_cosines(const Nodes& nodes, const Sights& out, const Sights& back,
                                     float* cosine) {
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const double nx = nodes.normal[0][i];
    const double ny = nodes.normal[1][i];
    const double nz = nodes.normal[2][i];
    const double hx = out.way[0][i] + back.way[0][i];
    const double hy = out.way[1][i] + back.way[1][i];
    const double hz = out.way[2][i] + back.way[2][i];
    const double squares = (hx * hx + hy * hy + hz * hz) * (nx * nx + ny * ny + nz * nz);
    cosine[i] =
        static_cast<float>(std::fabs(nx * hx + ny * hy + nz * hz) / std::sqrt(squares + 1e-30));
  }
}

// Diffuse part of the cross-section.
MAPPERD_VECTORISED void diffuse(const Nodes& nodes, bool lambert, const float* transmit,
                                const float* receive, float* section) {
  for (std::size_t i = 0; i < nodes.count; ++i) {
    section[i] = lambert ? nodes.mu[i] * transmit[i] * receive[i] : nodes.mu[i];
  }
}

// The lobe about the mirror's direction, see `Strength`.
MAPPERD_VECTORISED void add_lobe(const Nodes& nodes, const float* half, float* section) {
  constexpr float kPerOctave = 1.44269504F;
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const float square = half[i] * half[i];
    const float cos2 = square < 1.0F ? (square > 1e-6F ? square : 1e-6F) : 1.0F;
    const float fall = nodes.smoothness[i] * cos2 + nodes.steepness[i] * (1.0F / cos2 - 1.0F);
    const float flash = nodes.lobe_height[i] * fast_exp2(-kPerOctave * fall) / (cos2 * cos2);
    section[i] += fall < static_cast<float>(kFaintest) ? flash : 0.0F;
  }
}

MAPPERD_VECTORISED void times(const float* by, std::size_t count, float* section) {
  for (std::size_t i = 0; i < count; ++i) {
    section[i] *= by[i];
  }
}

// Phase, row, column, and the pressure that is left by spreading.
MAPPERD_VECTORISED void hear(const ScatterInput& e, const Leg& receive, const Sights& out,
                             const Sights& back, const Nodes& nodes, const float* section,
                             HeardNodes& to) {
  const std::size_t count = nodes.count;
  const EchoGrid& grid = e.grid;
  const double scale = 0.5 * grid.range_scale / grid.row_m;
  const double rows_per_m = 1.0 / grid.row_m;
  const double d0 = receive.drift_m[0] * rows_per_m;
  const double d1 = receive.drift_m[1] * rows_per_m;
  const double d2 = receive.drift_m[2] * rows_per_m;
  const auto last_row = static_cast<double>(grid.rows - 1);
  const double turns_per_m = e.model.turns_per_m;
  const auto first_sine = static_cast<float>(grid.first_sine);
  const auto columns_per_sine = static_cast<float>(1.0 / grid.sine_pitch);
  const bool spreading = e.model.spreading;
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
    const auto spread = static_cast<float>(out.range_m[i] * back.range_m[i]);
    const float part = spreading ? 1.0F / spread : 1.0F;
    to.pressure[i] = part * (nodes.gain[i] * std::sqrt(section[i]));
  }
}

// One-way pressure of the vertical pattern.
MAPPERD_VECTORISED void pattern(const Hearing& response, const float* __restrict w,
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

MAPPERD_VECTORISED void weigh(const float* __restrict there, const float* __restrict here,
                              const float* __restrict loss, const std::int32_t* __restrict row,
                              std::int32_t rows, std::size_t count, float* __restrict pressure) {
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t from = row[i] > 0 ? row[i] : 0;
    pressure[i] *= there[i] * here[i] * loss[from < rows ? from : rows - 1];
  }
}

}  // namespace

void ScattererKernel::strengths(const SharedTraits& traits, const Nodes& nodes,
                                const Sights& back) {
  const float* receive = cosine_[1];
  if (traits.round) {
    round_cosines(nodes, out_, back, cosine_, area_);
  } else {
    flat_cosines(nodes.height_m[0], out_, nodes.count, cosine_[0]);
    if (traits.same_leg()) {
      receive = cosine_[0];
    } else {
      flat_cosines(nodes.height_m[1], back, nodes.count, cosine_[1]);
    }
  }
  diffuse(nodes, e_.model.lambert, cosine_[0], receive, section_);
  if (traits.lobe) {
    const float* half = cosine_[0];
    if (!traits.same_leg()) {
      half_cosines(nodes, out_, back, cosine_[2]);
      half = cosine_[2];
    }
    add_lobe(nodes, half, section_);
  }
  if (traits.round) {
    times(area_, nodes.count, section_);
  }
}

const HeardNodes& ScattererKernel::heard(const SharedTraits& traits, const Nodes& nodes) {
  look(*traits.transmit, nodes, nodes.count, out_);
  const bool same = traits.same_leg();
  if (!same) {
    look(*traits.receive, nodes, nodes.count, back_);
  }
  const Sights& back = same ? out_ : back_;
  strengths(traits, nodes, back);
  hear(e_, *traits.receive, out_, back, nodes, section_, heard_);
  pattern(e_.response, out_.w, nodes.count, there_);
  if (!same) {
    pattern(e_.response, back_.w, nodes.count, here_);
  }
  weigh(there_, same ? there_ : here_, e_.response.loss, heard_.row,
        static_cast<std::int32_t>(e_.grid.rows), nodes.count, heard_.pressure);
  return heard_;
}

}  // namespace mapperd::acoustics
