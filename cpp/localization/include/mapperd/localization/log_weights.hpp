// Weights as logarithms, that no scan can drive to 0.
#pragma once

#include <cstddef>
#include <vector>

namespace mapperd::localization {

// What one reweighting did.
struct Reweighted {
  bool informative = false;      // false: nothing finite came, and the weights stay as they were
  double log_evidence = 0.0;     // ln sum w_i l_i, with weights of sum 1 before
  std::size_t not_a_number = 0;  // likelihoods that were NaN or infinite: they count as 0
};

// Multiplies weights of sum 1 by likelihoods and makes the sum 1 again. Sums have one order.
Reweighted reweight(std::vector<double>& log_weight, const std::vector<double>& log_likelihood);

// The largest exponent in (0, 1], to a 256th, by which likelihoods leave at least `share` of the
// effective size that the weights have. 1 where nothing finite came.
double bearable_exponent(const std::vector<double>& log_weight,
                         const std::vector<double>& log_likelihood, double share);

// Weights of sum 1 as they are, and their squares' sum.
std::vector<double> linear_weights(const std::vector<double>& log_weight);

// (sum w)^2 / sum w^2: how many equal particles would tell as much. 0 for none.
double effective_size(const std::vector<double>& weight);

}  // namespace mapperd::localization
