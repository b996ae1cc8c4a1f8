// Drawing the next cloud from the weighted one.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/grid.hpp"
#include "mapperd/localization/kld.hpp"

namespace mapperd::localization {

enum class Scheme {
  kLowVariance,  // one random offset and a comb: each comes as often as its weight says, +-1
  kMultinomial,  // independent draws
};

struct ResampleRule {
  std::size_t min_particles = 100;
  std::size_t max_particles = 5000;
  KldRule kld;
  Scheme scheme = Scheme::kLowVariance;
};

struct Drawn {
  std::vector<std::size_t> parent;  // kRandom: drawn from the free space
  std::size_t buckets = 0;          // 0: not counted, the number of particles is fixed
};
inline constexpr std::size_t kRandom = static_cast<std::size_t>(-1);

// Parents of the next cloud. Each but the first is, with probability `random_share`, a draw from
// `free` (nullptr: none). The number is that of the KLD rule: independent draws go on while fewer
// than the rule wants have been seen, from min to max. With the comb those draws tell the number
// only. `converged`: the cloud is known to fit into a bucket, and two buckets or fewer want
// min_particles instead of max_particles.
Drawn draw_parents(const Particles& particles, const std::vector<double>& weight,
                   const ResampleRule& rule, bool converged, double random_share,
                   const FreeSpace* free, const Stream& stream);

// The comb alone: `count` parents of weights of any sum above 0, for an offset in [0, 1).
std::vector<std::size_t> comb(const std::vector<double>& weight, std::size_t count, double offset);

}  // namespace mapperd::localization
