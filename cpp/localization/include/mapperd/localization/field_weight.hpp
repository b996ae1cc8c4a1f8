/// \file
/// \brief Log-likelihoods of particles, from the likelihood field at the ends of beams.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/likelihood_field.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

/// How the beams' densities p become one likelihood.
enum class BeamAggregation {
  kCubeSum,  ///< 1 + sum p^3: a vote in which outliers have no cost
  kProduct,  ///< exp(kappa sum ln p)
};

/// Ends of beams in the levelled base frame. Beam j has `fan` ends from j * fan on, one for each
/// elevation within the sonar's opening: the likeliest counts. A flat field takes no heights.
struct Endpoints {
  std::size_t fan = 1;
  std::vector<double> x_m;
  std::vector<double> y_m;
  std::vector<double> z_m;      ///< in the map frame (the base's height added); empty: flat
  std::vector<double> quality;  ///< of each beam, 0 ... 1: p becomes q p + (1 - q) background

  std::size_t beams() const { return quality.size(); }
};

/// \throws std::invalid_argument for arrays that do not fit together or are not finite.
void check_endpoints(const Endpoints& ends);

/// Writes the log-likelihoods of particles first ... last - 1 to out[first] ... out[last - 1].
/// Threads may share all arguments but `out`.
void field_log_likelihoods(const LikelihoodField& field, const Endpoints& ends,
                           BeamAggregation aggregation, double kappa, const Particles& particles,
                           std::size_t first, std::size_t last, double* out);

}  // namespace mapperd::localization
