/// \file
/// \brief Modes of a particle cloud.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/estimate.hpp"

namespace mapperd::localization {

/// Buckets of the clusters; finer than those of KLD-sampling.
struct ClusterParams {
  double bucket_xy_m = 0.2;
  double bucket_yaw_rad = 0.524;
  double cap_percentile = 0.9;  ///< buckets' mean weights are cut to this percentile's
};

/// Cluster of each particle; 0 is the heaviest. Buckets are visited by falling mean weight; one
/// without a cluster begins one, which spreads to neighbours along x, y and yaw that are not
/// heavier.
struct Clusters {
  std::vector<std::size_t> label;
  std::vector<double> mass;  ///< falling
  std::vector<std::size_t> particles;
};

/// \throws std::invalid_argument for buckets of no size.
Clusters clusters_of(const Particles& particles, const std::vector<double>& weight,
                     const ClusterParams& rule);

/// Estimate from the heaviest cluster of at least two particles, or from all particles if no
/// cluster has two.
Estimate best_estimate(const Particles& particles, const std::vector<double>& weight,
                       const Clusters& clusters);

}  // namespace mapperd::localization
