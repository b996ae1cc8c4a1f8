/// \file
/// \brief The patch of a face's plane within a ray's cell of directions, and its echo strength.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "mapperd/acoustics/scatter.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// Unit vector in the object's frame with direction cosines s (starboard) and w (up).
inline Vec3 direction(const Leg& leg, double s, double w) {
  const double x = std::sqrt(std::max(1.0 - s * s - w * w, 1e-9));
  const auto& m = leg.rotation;
  return {m[0] * x - m[1] * s + m[2] * w, m[3] * x - m[4] * s + m[5] * w,
          m[6] * x - m[7] * s + m[8] * w};
}

/// The part of a cell's width in s that contains directions: s² + w² is at most 1.
struct ValidSines {
  double max_s, from_s, to_s;
};

inline ValidSines valid_sines(double from_s, double to_s, double w) {
  const double most = std::sqrt(std::max(1.0 - w * w, 1e-12));
  return {most, std::min(std::max(from_s, -most), most), std::min(std::max(to_s, -most), most)};
}

/// Maximum hits of a batch. Loops over a batch run to its end, whether it is full or not.
constexpr std::size_t kPatches = 32;

/// One number per hit of a batch.
template <typename Number>
using PerHit = Number[kPatches];

/// The patches of faces' planes that the cells of some rays cover, in the objects' frames: one
/// array per quantity, so that loops over them become vector code.
struct Footprints {
  std::size_t count = 0;
  PerHit<std::size_t> hit{};
  PerHit<bool> exists{};  ///< false beyond `count`, and where a leg does not see the plane's front
  PerHit<double> normal[3]{};                              ///< of length 1
  PerHit<double> offset{};                                 ///< of the plane n.p
  PerHit<double> origin_m[3]{};                            ///< of the seeing leg
  PerHit<double> height_m{};                               ///< of the plane over it, along n
  PerHit<double> transmit_height_m{}, receive_height_m{};  ///< over the other legs' origins
  PerHit<double> min_facing{};                             ///< minimum |n.d| within a patch
  PerHit<double> corner_m[3][4]{};                         ///< by axis, around the patch
  PerHit<double> min_m{}, max_m{};   ///< ranges between which the plane is followed
  PerHit<double> near_m{}, far_m{};  ///< ranges of the corners from the seeing origin
};

/// A grazing plane is followed up to this multiple of the hit's range.
constexpr double kMaxRangeFactor = 1.6;

/// Minimum cosine of incidence on a round surface.
constexpr double kMinCosine = 0.05;

/// Fills a batch with the next hits that have a face.
/// Returns the first hit that it did not look at, or `last`.
std::size_t footprints_of(const ScatterInput& echoes, std::size_t first, std::size_t last,
                          Footprints& patches);

/// Lobes weaker than exp(-this) are ignored.
constexpr double kFaintest = 25.0;

/// Back-scattering cross-section per unit area.
class Strength {
 public:
  /// `step_rad`: spacing of the queried directions.
  Strength(const ScatterModel& model, const Material& material, double step_rad)
      : mu_(material.mu), lambert_(model.lambert) {
    if (!model.specular || material.reflection_power <= 0.0) {
      return;
    }
    constexpr double kPi = 3.14159265358979323846;
    const double slope2 = material.slope_rad * material.slope_rad + 0.25 * step_rad * step_rad;
    const double wavenumber = 2.0 * kPi * model.turns_per_m;
    lobe_ = material.reflection_power / (8.0 * kPi * slope2);
    steepness_ = 0.5 / slope2;
    smoothness_ = 4.0 * wavenumber * wavenumber * material.roughness_m * material.roughness_m;
  }
  [[nodiscard]] bool has_lobe() const { return lobe_ > 0.0; }

  /// By the cosines to the transmitter, to the receiver, and of the half-way direction.
  [[nodiscard]] double at(double transmit, double receive, double half) const {
    const double diffuse = lambert_ ? mu_ * transmit * receive : mu_;
    return lobe_ > 0.0 ? diffuse + lobe(half) : diffuse;
  }

  /// Parameters for vectorised callers.
  [[nodiscard]] float mu() const { return static_cast<float>(mu_); }
  [[nodiscard]] float lobe_height() const { return static_cast<float>(lobe_); }
  [[nodiscard]] float steepness() const { return static_cast<float>(steepness_); }
  [[nodiscard]] float smoothness() const { return static_cast<float>(smoothness_); }

 private:
  [[nodiscard]] double lobe(double half) const;
  double mu_;
  bool lambert_;
  double lobe_ = 0.0;        ///< |reflection|² / (8 pi slope²)
  double steepness_ = 0.0;   ///< 1 / (2 slope²)
  double smoothness_ = 0.0;  ///< 4 k² roughness²
};

/// Cosine between a normal and the half-way direction of two unit vectors.
inline double half_cosine(const Vec3& normal, const Vec3& a, const Vec3& b) {
  const Vec3 sum = a + b;
  return std::fabs(dot(normal, sum)) / std::sqrt(std::max(dot(sum, sum), 1e-12));
}

/// Maximum rotation of a round surface's normal per metre, rad/m.
double turn_per_m(const double* curved_normal);

/// Normal of a round surface at a point of one of its faces.
Vec3 curved_normal_at(const double* curved_normal, const Vec3& point_m);

}  // namespace mapperd::acoustics
