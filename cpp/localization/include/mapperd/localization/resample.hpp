/// \file
/// \brief Resampling: draws the next cloud from the weighted one.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/grid.hpp"
#include "mapperd/localization/kld.hpp"

namespace mapperd::localization {

/// How particles are drawn by their weights.
enum class Scheme {
  kLowVariance,  ///< one random offset and a comb: each is drawn in proportion to its weight, +-1
  kMultinomial,  ///< independent draws
};

/// How many particles are drawn, and how.
struct ResampleParams {
  std::size_t min_particles = 100;
  std::size_t max_particles = 5000;
  KldParams kld;
  Scheme scheme = Scheme::kLowVariance;
};

/// Result of resampling: where each new particle comes from.
struct Drawn {
  std::vector<std::size_t> parent;  ///< kRandom: drawn from the free space
  std::size_t buckets = 0;          ///< 0: not counted, the number of particles is fixed
};
inline constexpr std::size_t kRandom = static_cast<std::size_t>(-1);

/// Draws the parents of the next cloud. Each but the first is, with probability `random_share`, a
/// draw from `free` (nullptr: none). The number is that of the KLD rule: independent draws go on
/// while fewer than the rule wants have been seen, from min to max. With the comb those draws only
/// set the number. `converged`: the cloud is known to fit into a bucket, and two buckets or fewer
/// want min_particles instead of max_particles.
Drawn draw_parents(const Particles& particles, const std::vector<double>& weight,
                   const ResampleParams& rule, bool converged, double random_share,
                   const FreeSpace* free, const Stream& stream);

/// Low-variance resampling: `count` parents from weights of any positive sum, for an offset in [0,
/// 1).
std::vector<std::size_t> comb(const std::vector<double>& weight, std::size_t count, double offset);

}  // namespace mapperd::localization
