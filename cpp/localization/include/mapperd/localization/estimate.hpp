/// \file
/// \brief Mean pose and covariance of a particle cloud.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

inline constexpr double kMinVariance = 1e-12;  ///< m^2, rad^2

/// Mean and covariance of weighted poses; metres and radians.
struct Estimate {
  Pose2 mean;
  /// Order x, y, yaw; m^2, m rad, rad^2. For x and y: unbiased for reliability weights, sum w d d^T
  /// / (1 - sum w^2). Of the heading: -2 ln R, +infinity where headings cancel out (then the mean
  /// is 0). Cross terms: sum w d wrap(heading - mean), made smaller where the matrix would not be
  /// one of covariance.
  Matrix3 covariance{};
  double mass = 0.0;          ///< weight of the particles used
  std::size_t particles = 0;  ///< number of the particles used
  bool heading_known = true;  ///< headings do not cancel out
  bool spread_known = true;   ///< more than one particle carries weight
};

/// Estimate from the particles in `chosen`, whose weights need not sum to 1. Two passes: no
/// cancellation far from the origin. Variances are at least kMinVariance.
Estimate estimate_of(const Particles& particles, const std::vector<double>& weight,
                     const std::vector<std::size_t>& chosen);

Estimate estimate_of(const Particles& particles, const std::vector<double>& weight);

}  // namespace mapperd::localization
