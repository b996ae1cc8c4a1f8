#include "nodes.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/acoustics/lattice.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

// Loops that run to a multiple of the vectors' length go over what is not read.

// Part of a lattice's cell over which its node may lie. Pixels hold the more equal numbers of nodes
// the smaller it is; phases are random anyway.
constexpr float kSpread = 0.5F;

// One patch's vectors, in the nodes' precision.
struct NodeSteps {
  NodeSteps(const Linear& from, std::size_t patch) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      first[axis] = static_cast<float>(from.first[axis][patch]);
      along[axis] = static_cast<float>(from.along[axis][patch]);
      across[axis] = static_cast<float>(from.across[axis][patch]);
    }
  }
  float first[3], along[3], across[3];
};

// Random places within the lattice's cells: in steps from the patch's first node, and as points.
MAPPERD_VECTORISED void jitter(const Patches& patches, std::size_t patch, std::size_t first,
                               std::size_t count, Nodes& nodes, float* __restrict along,
                               float* __restrict across) {
  const NodeSteps from(patches.place, patch);
  const std::uint64_t key = patches.key[patch];
  const auto low = static_cast<std::uint32_t>(key);
  const auto high = static_cast<std::uint32_t>(key >> 32);
  const auto first_i =
      static_cast<std::uint32_t>(static_cast<std::int64_t>(patches.first_i[patch]));
  const auto first_j =
      static_cast<std::uint32_t>(static_cast<std::int64_t>(patches.first_j[patch]));
  const float x0 = from.first[0], y0 = from.first[1], z0 = from.first[2];
  const float xa = from.along[0], ya = from.along[1], za = from.along[2];
  const float xb = from.across[0], yb = from.across[1], zb = from.across[2];
  const std::int32_t* __restrict from_i = nodes.i + first;
  const std::int32_t* __restrict from_j = nodes.j + first;
  std::uint32_t* __restrict bits = nodes.bits + first;
  float* __restrict x = nodes.point_m[0] + first;
  float* __restrict y = nodes.point_m[1] + first;
  float* __restrict z = nodes.point_m[2] + first;
  constexpr float kUnit = kSpread * 0x1p-16F;
  constexpr float kFirst = 0.5F * (1.0F - kSpread);
  for (std::size_t start = 0; start < count; start += kLanes) {
    for (std::size_t at = start; at < start + kLanes; ++at) {
      const NodeBits random = node_bits(low, high, first_i + static_cast<std::uint32_t>(from_i[at]),
                                        first_j + static_cast<std::uint32_t>(from_j[at]));
      const auto jitter_i = static_cast<std::int32_t>(random.place & 0xFFFFU);
      const auto jitter_j = static_cast<std::int32_t>(random.place >> 16);
      const float a =
          static_cast<float>(from_i[at]) + (kFirst + static_cast<float>(jitter_i) * kUnit);
      const float b =
          static_cast<float>(from_j[at]) + (kFirst + static_cast<float>(jitter_j) * kUnit);
      along[at] = a;
      across[at] = b;
      x[at] = x0 + (xa * a + xb * b);
      y[at] = y0 + (ya * a + yb * b);
      z[at] = z0 + (za * a + zb * b);
      bits[at] = random.echo;
    }
  }
}

// Normals at such places.
MAPPERD_VECTORISED void interpolate_normals(const NodeSteps& from, const float* __restrict along,
                                            const float* __restrict across, std::size_t first,
                                            std::size_t count, Nodes& nodes) {
  const float x0 = from.first[0], y0 = from.first[1], z0 = from.first[2];
  const float xa = from.along[0], ya = from.along[1], za = from.along[2];
  const float xb = from.across[0], yb = from.across[1], zb = from.across[2];
  float* __restrict x = nodes.normal[0] + first;
  float* __restrict y = nodes.normal[1] + first;
  float* __restrict z = nodes.normal[2] + first;
  for (std::size_t at = 0; at < count; ++at) {
    x[at] = x0 + (xa * along[at] + xb * across[at]);
    y[at] = y0 + (ya * along[at] + yb * across[at]);
    z[at] = z0 + (za * along[at] + zb * across[at]);
  }
}

MAPPERD_INLINE void repeat(float value, std::size_t count, float* to) {
  for (std::size_t start = 0; start < count; start += kLanes) {
    std::fill_n(to + start, kLanes, value);
  }
}

// Points relative to a leg that lie at `shift_m` from the nodes' own.
MAPPERD_VECTORISED void relative_to_leg(const Leg& leg, const Nodes& nodes, const Vec3& shift_m,
                                        PolarPoints& to) {
  const float o[3] = {static_cast<float>(shift_m.x), static_cast<float>(shift_m.y),
                      static_cast<float>(shift_m.z)};
  float m[9];
  for (std::size_t k = 0; k < 9; ++k) {
    m[k] = static_cast<float>(leg.rotation[k]);
  }
  const float* __restrict px = nodes.point_m[0];
  const float* __restrict py = nodes.point_m[1];
  const float* __restrict pz = nodes.point_m[2];
  float* __restrict to_range = to.range_m;
  float* __restrict to_x = to.way[0];
  float* __restrict to_y = to.way[1];
  float* __restrict to_z = to.way[2];
  float* __restrict to_s = to.s;
  float* __restrict to_w = to.w;
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const float x = px[i] + o[0];
    const float y = py[i] + o[1];
    const float z = pz[i] + o[2];
    const float range_m = std::sqrt(x * x + y * y + z * z + 1e-12F);
    const float part = 1.0F / range_m;
    const float dx = x * part;
    const float dy = y * part;
    const float dz = z * part;
    to_range[i] = range_m;
    to_x[i] = dx;
    to_y[i] = dy;
    to_z[i] = dz;
    to_s[i] = -(m[1] * dx + m[4] * dy + m[7] * dz);
    to_w[i] = m[2] * dx + m[5] * dy + m[8] * dz;
  }
}

// Cosines of incidence on a plane.
MAPPERD_VECTORISED void flat_cosines(const float* __restrict height_m,
                                     const float* __restrict range_m, std::size_t count,
                                     float* __restrict cosine) {
  for (std::size_t i = 0; i < count; ++i) {
    cosine[i] = height_m[i] / range_m[i];
  }
}

// Cosines on the round surface that the plane stands for, and the area seen over the plane's.
MAPPERD_VECTORISED void round_cosines(const Nodes& nodes, const PolarPoints& out,
                                      const PolarPoints& back, float* __restrict to_out,
                                      float* __restrict to_back, float* __restrict area) {
  constexpr auto kLeast = static_cast<float>(kMinCosine);
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const float nx = nodes.normal[0][i];
    const float ny = nodes.normal[1][i];
    const float nz = nodes.normal[2][i];
    const float part = 1.0F / std::sqrt(nx * nx + ny * ny + nz * nz + 1e-30F);
    const float transmit =
        std::fabs(nx * out.way[0][i] + ny * out.way[1][i] + nz * out.way[2][i]) * part;
    to_out[i] = transmit;
    to_back[i] = std::fabs(nx * back.way[0][i] + ny * back.way[1][i] + nz * back.way[2][i]) * part;
    const float least = transmit > kLeast ? transmit : kLeast;
    area[i] = nodes.height_m[0][i] / (out.range_m[i] * least);
  }
}

// Cosine of the half-way direction with the surface's normal.
MAPPERD_VECTORISED void half_cosines(const Nodes& nodes, const PolarPoints& out,
                                     const PolarPoints& back, float* __restrict cosine) {
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const float nx = nodes.normal[0][i];
    const float ny = nodes.normal[1][i];
    const float nz = nodes.normal[2][i];
    const float hx = out.way[0][i] + back.way[0][i];
    const float hy = out.way[1][i] + back.way[1][i];
    const float hz = out.way[2][i] + back.way[2][i];
    const float squares = (hx * hx + hy * hy + hz * hz) * (nx * nx + ny * ny + nz * nz);
    cosine[i] = std::fabs(nx * hx + ny * hy + nz * hz) / std::sqrt(squares + 1e-30F);
  }
}

// Diffuse part of the cross-section.
MAPPERD_VECTORISED void diffuse(const float* __restrict mu, bool lambert,
                                const float* __restrict transmit, const float* __restrict receive,
                                std::size_t count, float* __restrict section) {
  for (std::size_t i = 0; i < count; ++i) {
    section[i] = lambert ? mu[i] * transmit[i] * receive[i] : mu[i];
  }
}

// The lobe about the mirror's direction, see `Strength`.
MAPPERD_VECTORISED void add_lobe(const Nodes& nodes, const float* __restrict half,
                                 float* __restrict section) {
  constexpr float kPerOctave = 1.44269504F;
  for (std::size_t i = 0; i < nodes.count; ++i) {
    const float square = half[i] * half[i];
    const float cos2 = square < 1.0F ? (square > 1e-6F ? square : 1e-6F) : 1.0F;
    const float fall = nodes.smoothness[i] * cos2 + nodes.steepness[i] * (1.0F / cos2 - 1.0F);
    const float flash = nodes.lobe_height[i] * fast_exp2(-kPerOctave * fall) / (cos2 * cos2);
    // With bit operations, because a conditional would become a branch.
    const std::int32_t some = -static_cast<std::int32_t>(fall < static_cast<float>(kFaintest));
    section[i] += float_of(bits_of(flash) & some);
  }
}

MAPPERD_VECTORISED void times(const float* __restrict by, std::size_t count,
                              float* __restrict section) {
  for (std::size_t i = 0; i < count; ++i) {
    section[i] *= by[i];
  }
}

// Phase and row; x, y and z are the direction to the echo.
MAPPERD_VECTORISED void phases_and_rows(const ScatterInput& e, const Vec3& drift_m,
                                        const float* __restrict out_m,
                                        const float* __restrict back_m, const float* __restrict x,
                                        const float* __restrict y, const float* __restrict z,
                                        std::size_t count, float* __restrict to_turns,
                                        std::int32_t* __restrict to_row) {
  const EchoGrid& grid = e.grid;
  const auto rows_per_m = static_cast<float>(0.5 * grid.range_scale / grid.row_m);
  const auto d0 = static_cast<float>(drift_m[0] / grid.row_m);
  const auto d1 = static_cast<float>(drift_m[1] / grid.row_m);
  const auto d2 = static_cast<float>(drift_m[2] / grid.row_m);
  const auto end = static_cast<float>(grid.rows);
  const auto turns_per_m = static_cast<float>(e.model.turns_per_m);
  for (std::size_t i = 0; i < count; ++i) {
    const float both_m = out_m[i] + back_m[i];
    const float drift = d0 * x[i] + d1 * y[i] + d2 * z[i];
    const float at = rows_per_m * both_m + drift;
    // Beyond the grid on either side: one row that does not exist.
    const float within = at < 0.0F ? -1.0F : (at > end ? end : at);
    to_row[i] = static_cast<std::int32_t>(within + 1.0F) - 1;
    const float turns = both_m * turns_per_m;
    to_turns[i] = turns - static_cast<float>(static_cast<std::int32_t>(turns));
  }
}

MAPPERD_VECTORISED void columns_of(const EchoGrid& grid, const float* __restrict s,
                                   std::size_t count, float* __restrict column) {
  const auto first_sine = static_cast<float>(grid.first_sine);
  const auto columns_per_sine = static_cast<float>(1.0 / grid.sine_pitch);
  for (std::size_t i = 0; i < count; ++i) {
    column[i] = (s[i] - first_sine) * columns_per_sine;
  }
}

// The pressure that is left by spreading.
MAPPERD_VECTORISED void spreading_loss(bool spreading, const float* __restrict out_m,
                                       const float* __restrict back_m, const float* __restrict gain,
                                       const float* __restrict section, std::size_t count,
                                       float* __restrict pressure) {
  const float lost = spreading ? 1.0F : 0.0F;
  const float kept = 1.0F - lost;
  for (std::size_t i = 0; i < count; ++i) {
    pressure[i] = gain[i] * std::sqrt(section[i]) / (lost * (out_m[i] * back_m[i]) + kept);
  }
}

// One-way pressure of the vertical pattern.
MAPPERD_VECTORISED void pattern(const EchoResponse& response, const float* __restrict w,
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

MAPPERD_VECTORISED void apply_weights(const float* __restrict there, const float* __restrict here,
                                      const float* __restrict loss,
                                      const std::int32_t* __restrict row, std::int32_t last_row,
                                      std::size_t count, float* __restrict pressure) {
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t from = row[i] > 0 ? row[i] : 0;
    const std::int32_t at = from < last_row ? from : last_row;
    pressure[i] *= there[i] * here[i] * loss[at];
  }
}

}  // namespace

void place(const Footprints& footprints, const Patches& patches, std::size_t patch,
           const Strength& strength, double gain, const SharedTraits& traits, std::size_t first,
           Nodes& nodes) {
  const std::size_t count = nodes.count - first;
  Each<float> along, across;
  jitter(patches, patch, first, count, nodes, along, across);
  const auto height_m = [](const PerHit<double>& of, std::size_t at) {
    return static_cast<float>(std::fabs(of[at]));
  };
  repeat(height_m(footprints.transmit_height_m, patch), count, nodes.height_m[0] + first);
  repeat(static_cast<float>(gain), count, nodes.gain + first);
  repeat(strength.mu(), count, nodes.mu + first);
  if (!traits.same_leg()) {
    repeat(height_m(footprints.receive_height_m, patch), count, nodes.height_m[1] + first);
  }
  if (traits.round) {
    // A whole number of vectors, as above.
    const std::size_t whole = (count + kLanes - 1) / kLanes * kLanes;
    interpolate_normals(NodeSteps(patches.normal, patch), along, across, first, whole, nodes);
  }
  if (!traits.lobe) {
    return;
  }
  repeat(strength.lobe_height(), count, nodes.lobe_height + first);
  repeat(strength.steepness(), count, nodes.steepness + first);
  repeat(strength.smoothness(), count, nodes.smoothness + first);
  for (std::size_t axis = 0; axis < 3 && !traits.round; ++axis) {
    repeat(static_cast<float>(footprints.normal[axis][patch]), count, nodes.normal[axis] + first);
  }
}

void ScattererKernel::strengths(const SharedTraits& traits, const Nodes& nodes,
                                const PolarPoints& back) {
  const float* receive = cosine_[1];
  if (traits.round) {
    round_cosines(nodes, out_, back, cosine_[0], cosine_[1], area_);
  } else {
    flat_cosines(nodes.height_m[0], out_.range_m, nodes.count, cosine_[0]);
    if (traits.same_leg()) {
      receive = cosine_[0];
    } else {
      flat_cosines(nodes.height_m[1], back.range_m, nodes.count, cosine_[1]);
    }
  }
  diffuse(nodes.mu, e_.model.lambert, cosine_[0], receive, nodes.count, section_);
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
  relative_to_leg(*traits.transmit, nodes, {0.0, 0.0, 0.0}, out_);
  const bool same = traits.same_leg();
  if (!same) {
    relative_to_leg(*traits.receive, nodes, traits.transmit->origin_m - traits.receive->origin_m,
                    back_);
  }
  const PolarPoints& back = same ? out_ : back_;
  strengths(traits, nodes, back);
  phases_and_rows(e_, traits.receive->drift_m, out_.range_m, back.range_m, out_.way[0], out_.way[1],
                  out_.way[2], nodes.count, heard_.turns, heard_.row);
  columns_of(e_.grid, back.s, nodes.count, heard_.column);
  if (e_.hits.both_ways) {
    columns_of(e_.grid, out_.s, nodes.count, heard_.other_column);
  }
  spreading_loss(e_.model.spreading, out_.range_m, back.range_m, nodes.gain, section_, nodes.count,
                 heard_.pressure);
  pattern(e_.response, out_.w, nodes.count, there_);
  if (!same) {
    pattern(e_.response, back_.w, nodes.count, here_);
  }
  apply_weights(there_, same ? there_ : here_, e_.response.loss, heard_.row,
                static_cast<std::int32_t>(e_.grid.rows) - 1, nodes.count, heard_.pressure);
  return heard_;
}

}  // namespace mapperd::acoustics
