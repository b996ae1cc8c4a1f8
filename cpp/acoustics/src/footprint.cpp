#include "acoustics/footprint.hpp"

#include <algorithm>

#include "acoustics/fast_math.hpp"

namespace acoustics {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kFaintest = 25.0;  // a lobe weaker by exp of this is none

ACOUSTICS_VECTORISED void times_diffuse(float mu, bool lambert, const float* transmit,
                                        const float* receive, std::size_t count, float* section) {
  for (std::size_t i = 0; i < count; ++i) {
    section[i] *= lambert ? mu * transmit[i] * receive[i] : mu;
  }
}

struct Lobe {
  float height, steepness, smoothness;
};

ACOUSTICS_VECTORISED void times_both(float mu, bool lambert, const Lobe& lobe,
                                     const float* transmit, const float* receive, const float* half,
                                     std::size_t count, float* section) {
  constexpr float kPerOctave = 1.44269504F;
  const float height = lobe.height;
  const float steepness = lobe.steepness;
  const float smoothness = lobe.smoothness;
  for (std::size_t i = 0; i < count; ++i) {
    const float square = half[i] * half[i];
    const float cos2 = square < 1.0F ? (square > 1e-6F ? square : 1e-6F) : 1.0F;
    const float fall = smoothness * cos2 + steepness * (1.0F / cos2 - 1.0F);
    const float flash = height * fast_exp2(-kPerOctave * fall) / (cos2 * cos2);
    const float diffuse = lambert ? mu * transmit[i] * receive[i] : mu;
    section[i] *= diffuse + (fall < static_cast<float>(kFaintest) ? flash : 0.0F);
  }
}

}  // namespace

bool footprint_of(const Echoes& echoes, std::size_t hit, Footprint& patch) {
  const Hits& hits = echoes.hits;
  const double* plane = echoes.faces.planes + 4 * hits.face[hit];
  const Leg& leg = hits.legs[hits.seen[hit]];
  const float* cell = hits.cell + 4 * hit;
  patch.normal = {plane[0], plane[1], plane[2]};
  patch.height_m = plane[3] - dot(patch.normal, leg.origin_m);
  patch.transmit_height_m = plane[3] - dot(patch.normal, hits.legs[hits.transmit[hit]].origin_m);
  patch.receive_height_m = plane[3] - dot(patch.normal, hits.legs[hits.receive[hit]].origin_m);
  const double s[2] = {cell[0], cell[1]};
  const double w[2] = {cell[2], cell[3]};
  const double facing = dot(patch.normal, direction(leg, 0.5 * (s[0] + s[1]), 0.5 * (w[0] + w[1])));
  if (!(facing * patch.height_m > 0.0) || !(patch.height_m * patch.transmit_height_m > 0.0) ||
      !(patch.height_m * patch.receive_height_m > 0.0)) {
    return false;
  }
  patch.least_facing = std::fabs(facing) / kFarthest;
  const double sign = facing > 0.0 ? 1.0 : -1.0;
  patch.least_m = hits.span_m[2 * hit];
  patch.most_m = hits.span_m[2 * hit + 1];
  patch.near_m = HUGE_VAL;
  patch.far_m = 0.0;
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector d = direction(leg, s[k == 1 || k == 2], w[k >= 2]);
    const double along = std::max(sign * dot(patch.normal, d), patch.least_facing);
    const double range_m =
        std::clamp(std::fabs(patch.height_m) / along, patch.least_m, patch.most_m);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      patch.corner_m[k][axis] = leg.origin_m[axis] + range_m * d[axis];
    }
    patch.near_m = std::min(patch.near_m, range_m);
    patch.far_m = std::max(patch.far_m, range_m);
  }
  return true;
}

Strength::Strength(const Laws& laws, const Material& material, double step_rad)
    : mu_(material.mu), lambert_(laws.lambert) {
  if (!laws.specular || material.reflection_power <= 0.0) {
    return;
  }
  const double slope2 = material.slope_rad * material.slope_rad + 0.25 * step_rad * step_rad;
  const double wavenumber = 2.0 * kPi * laws.turns_per_m;
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

void Strength::times(const float* transmit, const float* receive, const float* half,
                     std::size_t count, float* section) const {
  const auto mu = static_cast<float>(mu_);
  if (lobe_ <= 0.0) {
    times_diffuse(mu, lambert_, transmit, receive, count, section);
    return;
  }
  const Lobe lobe{static_cast<float>(lobe_), static_cast<float>(steepness_),
                  static_cast<float>(smoothness_)};
  times_both(mu, lambert_, lobe, transmit, receive, half, count, section);
}

double turn_per_m(const double* bent) {
  double squares = 0.0;
  for (std::size_t row = 0; row < 3; ++row) {
    const double* g = bent + 4 * row;
    squares += g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
  }
  return std::sqrt(squares);
}

Vector bent_normal(const double* bent, const Vector& point_m) {
  Vector normal;
  for (std::size_t row = 0; row < 3; ++row) {
    const double* g = bent + 4 * row;
    normal[row] = g[0] * point_m[0] + g[1] * point_m[1] + g[2] * point_m[2] + g[3];
  }
  const double length = std::sqrt(std::max(dot(normal, normal), 1e-30));
  return {normal[0] / length, normal[1] / length, normal[2] / length};
}

}  // namespace acoustics
