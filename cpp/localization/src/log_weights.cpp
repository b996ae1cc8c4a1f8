#include "mapperd/localization/log_weights.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {
namespace {

constexpr double kNever = -std::numeric_limits<double>::infinity();

MAPPERD_VECTORISED void exponentials(const double* powers, std::size_t count, double largest,
                                     double* out) {
  for (std::size_t i = 0; i < count; ++i) {
    const double power = powers[i] - largest;
    out[i] = power > -700.0 ? fast_exp(power) : 0.0;
  }
}

// Of a fixed order.
double sum_of(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum;
}

}  // namespace

Reweighted reweight(std::vector<double>& log_weight, const std::vector<double>& log_likelihood) {
  Reweighted done;
  std::vector<double> updated(log_weight.size());
  double largest = kNever;
  for (std::size_t i = 0; i < updated.size(); ++i) {
    const double value = log_likelihood[i];
    if (std::isnan(value) || value == -kNever) ++done.not_a_number;
    const bool counts = std::isfinite(value);
    updated[i] = counts ? log_weight[i] + value : kNever;
    if (std::isnan(updated[i])) updated[i] = kNever;
    largest = std::max(largest, updated[i]);
  }
  if (!std::isfinite(largest)) return done;
  std::vector<double> relative(updated.size());
  exponentials(updated.data(), updated.size(), largest, relative.data());
  done.informative = true;
  done.log_evidence = largest + std::log(sum_of(relative));
  for (double& value : updated) value -= done.log_evidence;
  log_weight.swap(updated);
  return done;
}

double bearable_exponent(const std::vector<double>& log_weight,
                         const std::vector<double>& log_likelihood, double share) {
  const double wanted = share * effective_size(linear_weights(log_weight));
  std::vector<double> raised(log_weight.size());
  const auto bearable = [&](double exponent) {
    for (std::size_t i = 0; i < raised.size(); ++i) raised[i] = exponent * log_likelihood[i];
    std::vector<double> weight = log_weight;
    const Reweighted done = reweight(weight, raised);
    return !done.informative || effective_size(linear_weights(weight)) >= wanted;
  };
  if (bearable(1.0)) return 1.0;
  int low = 1;
  int high = 256;
  while (high - low > 1) {
    const int middle = (low + high) / 2;
    (bearable(middle / 256.0) ? low : high) = middle;
  }
  return low / 256.0;
}

std::vector<double> linear_weights(const std::vector<double>& log_weight) {
  std::vector<double> weight(log_weight.size());
  exponentials(log_weight.data(), log_weight.size(), 0.0, weight.data());
  return weight;
}

double effective_size(const std::vector<double>& weight) {
  double sum = 0.0;
  double squares = 0.0;
  for (const double w : weight) {
    sum += w;
    squares += w * w;
  }
  return squares > 0.0 ? sum * sum / squares : 0.0;
}

}  // namespace mapperd::localization
