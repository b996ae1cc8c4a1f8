#include "mapperd/acoustics/footprint.hpp"

#include <algorithm>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

constexpr std::size_t kFetchAhead = 16;  // hits

// The seeing legs and the cells of a batch.
struct SeenCells {
  PerHit<double> rotation[9];  // of the seeing leg
  PerHit<double> from_s, to_s, from_w, to_w;
  PerHit<double> s_per_w, w_per_s;
};

// Copies what belongs to one hit into the batch.
void load_hit(const ScatterInput& echoes, std::size_t hit, SeenCells& seen, Footprints& to) {
  const RayHits& hits = echoes.hits;
  const std::size_t i = to.count++;
  const double* plane = echoes.faces.table[hits.face[hit]].plane;
  const Leg& leg = hits.legs[hits.seen[hit]];
  const Vec3& transmit_m = hits.legs[hits.transmit[hit]].origin_m;
  const Vec3& receive_m = hits.legs[hits.receive[hit]].origin_m;
  const Vec3 normal{plane[0], plane[1], plane[2]};
  to.hit[i] = hit;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    to.normal[axis][i] = plane[axis];
  }
  to.origin_m[0][i] = leg.origin_m.x;
  to.origin_m[1][i] = leg.origin_m.y;
  to.origin_m[2][i] = leg.origin_m.z;
  to.offset[i] = plane[3];
  to.height_m[i] = plane[3] - dot(normal, leg.origin_m);
  to.transmit_height_m[i] = plane[3] - dot(normal, transmit_m);
  to.receive_height_m[i] = plane[3] - dot(normal, receive_m);
  for (std::size_t k = 0; k < 9; ++k) {
    seen.rotation[k][i] = leg.rotation[k];
  }
  const float* cell = hits.cell + 4 * hit;
  seen.from_s[i] = cell[0];
  seen.to_s[i] = cell[1];
  seen.from_w[i] = cell[2];
  seen.to_w[i] = cell[3];
  seen.s_per_w[i] = hits.lean == nullptr ? 0.0F : hits.lean[2 * hit];
  seen.w_per_s[i] = hits.lean == nullptr ? 0.0F : hits.lean[2 * hit + 1];
  to.min_m[i] = hits.span_m[2 * hit];
  to.max_m[i] = hits.span_m[2 * hit + 1];
}

// Cosine between the normal and the direction at each cell's centre; 0 where no footprint exists.
MAPPERD_VECTORISED void compute_facing(const SeenCells& seen, const Footprints& patches,
                                       PerHit<double>& facing) {
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    const double w = 0.5 * (seen.from_w[i] + seen.to_w[i]);
    const ValidSines reals = valid_sines(seen.from_s[i], seen.to_s[i], w);
    const double s = 0.5 * (reals.from_s + reals.to_s);
    const double ahead = std::sqrt(std::max(1.0 - s * s - w * w, 1e-9));
    const auto& m = seen.rotation;
    const double x = m[0][i] * ahead - m[1][i] * s + m[2][i] * w;
    const double y = m[3][i] * ahead - m[4][i] * s + m[5][i] * w;
    const double z = m[6][i] * ahead - m[7][i] * s + m[8][i] * w;
    const double towards =
        patches.normal[0][i] * x + patches.normal[1][i] * y + patches.normal[2][i] * z;
    const double height_m = patches.height_m[i];
    const bool exists = (towards * height_m > 0.0) &
                        (height_m * patches.transmit_height_m[i] > 0.0) &
                        (height_m * patches.receive_height_m[i] > 0.0);
    facing[i] = exists ? towards : 0.0;
  }
}

// Where the cells' four edges meet the planes, and how far that is.
MAPPERD_VECTORISED void intersect_planes(const SeenCells& seen, const PerHit<double>& facing,
                                         Footprints& patches) {
  const PerHit<double>* const s_of[4] = {&seen.from_s, &seen.to_s, &seen.to_s, &seen.from_s};
  const PerHit<double>* const w_of[4] = {&seen.from_w, &seen.from_w, &seen.to_w, &seen.to_w};
  MAPPERD_INDEPENDENT
  for (std::size_t i = 0; i < kPatches; ++i) {
    patches.min_facing[i] = std::fabs(facing[i]) / kMaxRangeFactor;
    patches.near_m[i] = HUGE_VAL;
    patches.far_m[i] = 0.0;
  }
  for (std::size_t k = 0; k < 4; ++k) {
    const PerHit<double>& corner_s = *s_of[k];
    const PerHit<double>& corner_w = *w_of[k];
    MAPPERD_INDEPENDENT
    for (std::size_t i = 0; i < kPatches; ++i) {
      const double off_s = corner_s[i] - 0.5 * (seen.from_s[i] + seen.to_s[i]);
      const double off_w = corner_w[i] - 0.5 * (seen.from_w[i] + seen.to_w[i]);
      const double leaning_w = corner_w[i] + seen.w_per_s[i] * off_s;
      const double below_w = leaning_w < 1.0 ? leaning_w : 1.0;
      const double w = below_w > -1.0 ? below_w : -1.0;
      const double leaning_s = corner_s[i] + seen.s_per_w[i] * off_w;
      // Where the fan of directions ends, cells end with it.
      const double max_s = std::sqrt(1.0 - w * w);
      const double below_s = leaning_s < max_s ? leaning_s : max_s;
      const double s = below_s > -max_s ? below_s : -max_s;
      const double square = 1.0 - s * s - w * w;
      const double ahead = std::sqrt(square > 0.0 ? square : 0.0);
      const auto& m = seen.rotation;
      const double x = m[0][i] * ahead - m[1][i] * s + m[2][i] * w;
      const double y = m[3][i] * ahead - m[4][i] * s + m[5][i] * w;
      const double z = m[6][i] * ahead - m[7][i] * s + m[8][i] * w;
      // The side that the plane shows.
      const double sign = facing[i] > 0.0 ? 1.0 : -1.0;
      const double towards = sign * patches.normal[0][i] * x + sign * patches.normal[1][i] * y +
                             sign * patches.normal[2][i] * z;
      const double least = patches.min_facing[i];
      const double reach_m = std::fabs(patches.height_m[i]) / (towards > least ? towards : least);
      const double beyond_m = reach_m > patches.min_m[i] ? reach_m : patches.min_m[i];
      const double range_m = beyond_m < patches.max_m[i] ? beyond_m : patches.max_m[i];
      patches.near_m[i] = range_m < patches.near_m[i] ? range_m : patches.near_m[i];
      patches.far_m[i] = range_m > patches.far_m[i] ? range_m : patches.far_m[i];
      patches.corner_m[0][k][i] = patches.origin_m[0][i] + range_m * x;
      patches.corner_m[1][k][i] = patches.origin_m[1][i] + range_m * y;
      patches.corner_m[2][k][i] = patches.origin_m[2][i] + range_m * z;
    }
  }
}

}  // namespace

std::size_t footprints_of(const ScatterInput& echoes, std::size_t first, std::size_t last,
                          Footprints& patches) {
  SeenCells seen{};
  patches.count = 0;
  std::size_t hit = first;
  for (; hit < last && patches.count < kPatches; ++hit) {
    // Neighbours' faces lie far apart in the table.
    const std::size_t later = std::min(hit + kFetchAhead, last - 1);
    __builtin_prefetch(&echoes.faces.table[std::max(echoes.hits.face[later], 0)]);
    if (echoes.hits.face[hit] >= 0) {
      load_hit(echoes, hit, seen, patches);
    }
  }
  PerHit<double> facing;
  compute_facing(seen, patches, facing);
  intersect_planes(seen, facing, patches);
  for (std::size_t i = 0; i < kPatches; ++i) {
    patches.exists[i] = facing[i] != 0.0;
  }
  return hit;
}

// The Kirchhoff approximation's limit of geometric optics for Gaussian slopes.
double Strength::lobe(double half) const {
  const double cos2 = std::min(half * half, 1.0);
  const double fall = smoothness_ * cos2 + steepness_ * (1.0 / std::max(cos2, 1e-6) - 1.0);
  return fall < kFaintest ? lobe_ * std::exp(-fall) / (cos2 * cos2) : 0.0;
}

double turn_per_m(const double* curved_normal) {
  double squares = 0.0;
  for (std::size_t row = 0; row < 3; ++row) {
    const double* g = curved_normal + 4 * row;
    squares += g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
  }
  return std::sqrt(squares);
}

Vec3 curved_normal_at(const double* curved_normal, const Vec3& point_m) {
  Vec3 normal;
  for (std::size_t row = 0; row < 3; ++row) {
    const double* g = curved_normal + 4 * row;
    normal[row] = g[0] * point_m[0] + g[1] * point_m[1] + g[2] * point_m[2] + g[3];
  }
  const double length = std::sqrt(std::max(dot(normal, normal), 1e-30));
  return {normal[0] / length, normal[1] / length, normal[2] / length};
}

}  // namespace mapperd::acoustics
