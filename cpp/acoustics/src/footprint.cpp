#include "mapperd/acoustics/footprint.hpp"

#include <algorithm>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

constexpr double kPi = 3.14159265358979323846;

// Where the cell's four edges meet the plane, and how far that is; `sign` is the side that it
// shows.
MAPPERD_VECTORISED void follow(const Leg& leg, const float* cell, double sign, Footprint& patch,
                               std::array<double, 4>& range_m) {
  const double s[4] = {cell[0], cell[1], cell[1], cell[0]};
  const double w[4] = {cell[2], cell[2], cell[3], cell[3]};
  const auto& m = leg.rotation;
  const auto& o = leg.origin_m;
  const double n0 = sign * patch.normal[0], n1 = sign * patch.normal[1];
  const double n2 = sign * patch.normal[2];
  const double height_m = std::fabs(patch.height_m);
  const double min_facing = patch.min_facing;
  const double min_m = patch.min_m, max_m = patch.max_m;
  double range[4], x[4], y[4], z[4];
  for (std::size_t k = 0; k < 4; ++k) {
    // Where the fan of directions ends, cells end with it.
    const double max_s = std::sqrt(1.0 - w[k] * w[k]);
    const double below_s = s[k] < max_s ? s[k] : max_s;
    const double real_s = below_s > -max_s ? below_s : -max_s;
    const double square = 1.0 - real_s * real_s - w[k] * w[k];
    const double ahead = std::sqrt(square > 0.0 ? square : 0.0);
    x[k] = m[0] * ahead - m[1] * real_s + m[2] * w[k];
    y[k] = m[3] * ahead - m[4] * real_s + m[5] * w[k];
    z[k] = m[6] * ahead - m[7] * real_s + m[8] * w[k];
    const double facing = n0 * x[k] + n1 * y[k] + n2 * z[k];
    const double reach_m = height_m / (facing > min_facing ? facing : min_facing);
    const double beyond_m = reach_m > min_m ? reach_m : min_m;
    range[k] = beyond_m < max_m ? beyond_m : max_m;
  }
  for (std::size_t k = 0; k < 4; ++k) {
    range_m[k] = range[k];
    patch.corner_m[0][k] = o[0] + range[k] * x[k];
    patch.corner_m[1][k] = o[1] + range[k] * y[k];
    patch.corner_m[2][k] = o[2] + range[k] * z[k];
  }
}

}  // namespace

bool footprint_of(const ScatterInput& echoes, std::size_t hit, Footprint& patch) {
  const RayHits& hits = echoes.hits;
  const double* plane = echoes.faces.table[hits.face[hit]].plane;
  const Leg& leg = hits.legs[hits.seen[hit]];
  const float* cell = hits.cell + 4 * hit;
  patch.normal = {plane[0], plane[1], plane[2]};
  patch.height_m = plane[3] - dot(patch.normal, leg.origin_m);
  patch.transmit_height_m = plane[3] - dot(patch.normal, hits.legs[hits.transmit[hit]].origin_m);
  patch.receive_height_m = plane[3] - dot(patch.normal, hits.legs[hits.receive[hit]].origin_m);
  const double middle_w = 0.5 * (static_cast<double>(cell[2]) + cell[3]);
  const Reals reals = reals_of(cell[0], cell[1], middle_w);
  const Vec3 middle = direction(leg, 0.5 * (reals.from_s + reals.to_s), middle_w);
  const double facing = dot(patch.normal, middle);
  if (!(facing * patch.height_m > 0.0) || !(patch.height_m * patch.transmit_height_m > 0.0) ||
      !(patch.height_m * patch.receive_height_m > 0.0)) {
    return false;
  }
  patch.min_facing = std::fabs(facing) / kMaxRangeFactor;
  patch.min_m = hits.span_m[2 * hit];
  patch.max_m = hits.span_m[2 * hit + 1];
  std::array<double, 4> range_m;
  follow(leg, cell, facing > 0.0 ? 1.0 : -1.0, patch, range_m);
  patch.near_m = std::min({range_m[0], range_m[1], range_m[2], range_m[3]});
  patch.far_m = std::max({range_m[0], range_m[1], range_m[2], range_m[3]});
  return true;
}

Strength::Strength(const ScatterModel& model, const Material& material, double step_rad)
    : mu_(material.mu), lambert_(model.lambert) {
  if (!model.specular || material.reflection_power <= 0.0) {
    return;
  }
  const double slope2 = material.slope_rad * material.slope_rad + 0.25 * step_rad * step_rad;
  const double wavenumber = 2.0 * kPi * model.turns_per_m;
  lobe_ = material.reflection_power / (8.0 * kPi * slope2);
  steepness_ = 0.5 / slope2;
  smoothness_ = 4.0 * wavenumber * wavenumber * material.roughness_m * material.roughness_m;
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
