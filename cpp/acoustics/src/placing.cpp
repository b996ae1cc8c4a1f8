#include <algorithm>

#include "mapperd/common/fast_math.hpp"
#include "nodes.hpp"

namespace mapperd::acoustics {

namespace {

// From nodes to points of the patch's plane. Loops run to a multiple of the vectors' length, over
// what is not read.
MAPPERD_VECTORISED void points(const PatchModel& patch, std::size_t first, std::size_t count,
                               Nodes& nodes) {
  const Lattice& lattice = patch.lattice;
  const double u_shift = patch.first_i + lattice.i0 - 0.5;
  const double v_shift = patch.first_j + lattice.j0 - 0.5;
  const double along_u = lattice.along_m * lattice.cosine;
  const double along_v = lattice.along_m * lattice.sine;
  const double across_u = -lattice.across_m * lattice.sine;
  const double across_v = lattice.across_m * lattice.cosine;
  const Vec3& n = patch.normal;
  const double slope_u = n[patch.axes.u] / n[patch.axes.c];
  const double slope_v = n[patch.axes.v] / n[patch.axes.c];
  const double height_m = patch.offset / n[patch.axes.c];
  const std::uint64_t key = lattice.key;
  const auto low = static_cast<std::uint32_t>(key);
  const auto high = static_cast<std::uint32_t>(key >> 32);
  const auto first_i = static_cast<std::uint32_t>(static_cast<std::int64_t>(patch.first_i));
  const auto first_j = static_cast<std::uint32_t>(static_cast<std::int64_t>(patch.first_j));
  const std::int32_t* __restrict from_i = nodes.i + first;
  const std::int32_t* __restrict from_j = nodes.j + first;
  std::uint32_t* __restrict bits = nodes.bits + first;
  double* __restrict to_u = nodes.point_m[patch.axes.u] + first;
  double* __restrict to_v = nodes.point_m[patch.axes.v] + first;
  double* __restrict to_c = nodes.point_m[patch.axes.c] + first;
  for (std::size_t start = 0; start < count; start += kLanes) {
    std::uint32_t place[kLanes];
    for (std::size_t k = 0; k < kLanes; ++k) {
      const std::size_t at = start + k;
      const NodeBits random = node_bits(low, high, first_i + static_cast<std::uint32_t>(from_i[at]),
                                        first_j + static_cast<std::uint32_t>(from_j[at]));
      place[k] = random.place;
      bits[at] = random.echo;
    }
    for (std::size_t k = 0; k < kLanes; ++k) {
      constexpr double kUnit = 0x1p-16;
      const std::size_t at = start + k;
      const auto jitter_u = static_cast<std::int32_t>(place[k] & 0xFFFFU);
      const auto jitter_v = static_cast<std::int32_t>(place[k] >> 16);
      const double along = (from_i[at] + jitter_u * kUnit) + u_shift;
      const double across = (from_j[at] + jitter_v * kUnit) + v_shift;
      const double u = along * along_u + across * across_u;
      const double v = along * along_v + across * across_v;
      to_u[at] = u;
      to_v[at] = v;
      to_c[at] = height_m - slope_u * u - slope_v * v;
    }
  }
}

MAPPERD_VECTORISED void round_normals(const double* curved_normal, std::size_t first,
                                      std::size_t count, Nodes& nodes) {
  const double* __restrict x = nodes.point_m[0] + first;
  const double* __restrict y = nodes.point_m[1] + first;
  const double* __restrict z = nodes.point_m[2] + first;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const double gx = curved_normal[4 * axis], gy = curved_normal[4 * axis + 1],
                 gz = curved_normal[4 * axis + 2];
    const double g = curved_normal[4 * axis + 3];
    double* __restrict to = nodes.normal[axis] + first;
    for (std::size_t start = 0; start < count; start += kLanes) {
      for (std::size_t i = start; i < start + kLanes; ++i) {
        to[i] = gx * x[i] + gy * y[i] + gz * z[i] + g;
      }
    }
  }
}

template <typename Number>
MAPPERD_INLINE void repeat(Number value, std::size_t count, Number* to) {
  for (std::size_t start = 0; start < count; start += kLanes) {
    std::fill_n(to + start, kLanes, value);
  }
}

}  // namespace

void place(const PatchModel& patch, const SharedTraits& traits, std::size_t first, Nodes& nodes) {
  const std::size_t count = nodes.count - first;
  points(patch, first, count, nodes);
  repeat(static_cast<float>(patch.transmit_height_m), count, nodes.height_m[0] + first);
  repeat(patch.gain, count, nodes.gain + first);
  repeat(patch.strength.mu(), count, nodes.mu + first);
  if (!traits.same_leg()) {
    repeat(static_cast<float>(patch.receive_height_m), count, nodes.height_m[1] + first);
  }
  if (traits.round) {
    round_normals(patch.curved_normal, first, count, nodes);
  }
  if (!traits.lobe) {
    return;
  }
  repeat(patch.strength.lobe_height(), count, nodes.lobe_height + first);
  repeat(patch.strength.steepness(), count, nodes.steepness + first);
  repeat(patch.strength.smoothness(), count, nodes.smoothness + first);
  for (std::size_t axis = 0; axis < 3 && !traits.round; ++axis) {
    repeat(patch.normal[axis], count, nodes.normal[axis] + first);
  }
}

}  // namespace mapperd::acoustics
