/// \file
/// \brief Particle weights as logarithms, which no scan can drive to 0.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

namespace mapperd::localization {

/// Result of one reweighting.
struct Reweighted {
  bool informative = false;   ///< false: no likelihood was finite, and the weights did not change
  double log_evidence = 0.0;  ///< ln sum w_i l_i, with weights of sum 1 before
  std::size_t not_a_number = 0;  ///< likelihoods that were NaN or infinite: they count as 0
};

/// Multiplies weights of sum 1 by likelihoods and normalises them. The order of summation is fixed.
Reweighted reweight(std::vector<double>& log_weight, const std::vector<double>& log_likelihood);

/// The largest exponent in (0, 1], to a 256th, by which likelihoods leave at least `share` of the
/// effective size that the weights have. 1 if no likelihood is finite.
double bearable_exponent(const std::vector<double>& log_weight,
                         const std::vector<double>& log_likelihood, double share);

/// Returns weights of sum 1, not as logarithms.
std::vector<double> linear_weights(const std::vector<double>& log_weight);

/// (sum w)^2 / sum w^2: the number of equally weighted particles with as much information. 0 for no
/// particles.
double effective_size(const std::vector<double>& weight);

}  // namespace mapperd::localization
