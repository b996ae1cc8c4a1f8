// Where the cloud says the vehicle is.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

inline constexpr double kLeastVariance = 1e-12;  // m^2, rad^2

struct Estimate {
  Pose2 mean;
  // Of x and y: unbiased for weights of reliability, sum w d d^T / (1 - sum w^2). Of the heading:
  // -2 ln R, +infinity where headings cancel out (then the mean is 0). Cross terms:
  // sum w d wrap(heading - mean), made smaller where the matrix would not be one of covariance.
  Matrix3 covariance{};
  double mass = 0.0;          // weight of those counted
  std::size_t particles = 0;  // number of those counted
  bool heading_known = true;  // headings do not cancel out
  bool spread_known = true;   // more than one particle carries weight
};

// Of the particles in `chosen`, whose weights need not sum to 1. Two passes: no cancellation far
// from the origin. Variances are at least kLeastVariance.
Estimate estimate_of(const Particles& particles, const std::vector<double>& weight,
                     const std::vector<std::size_t>& chosen);

Estimate estimate_of(const Particles& particles, const std::vector<double>& weight);

}  // namespace mapperd::localization
