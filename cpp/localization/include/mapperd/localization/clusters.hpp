// The cloud's modes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/estimate.hpp"

namespace mapperd::localization {

// Buckets of the clusters; finer than those of the KLD rule.
struct ClusterRule {
  double bucket_xy_m = 0.2;
  double bucket_yaw_rad = 0.524;
  double cap_percentile = 0.9;  // buckets' mean weights are cut to this percentile's
};

// Each particle's cluster, 0 the heaviest. Buckets are visited by falling mean weight; one without
// a cluster begins one, which spreads to neighbours along x, y and yaw that are not heavier.
struct Clusters {
  std::vector<std::size_t> label;
  std::vector<double> mass;  // falling
  std::vector<std::size_t> particles;
};

// Throws std::invalid_argument for buckets of no size.
Clusters clusters_of(const Particles& particles, const std::vector<double>& weight,
                     const ClusterRule& rule);

// Of the heaviest cluster of at least two particles; of all particles where there is none.
Estimate best_estimate(const Particles& particles, const std::vector<double>& weight,
                       const Clusters& clusters);

}  // namespace mapperd::localization
