#include "mapperd/iwlo.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace mapperd {
namespace {

constexpr double kMaxCount = 65535.0;
constexpr double kMaxLogOdds = 1e4;  // exp() of it still has a meaning next to 1

void require(bool ok, const std::string& what) {
  if (!ok) throw std::invalid_argument(what);
}

double sigmoid(double x) { return 1.0 / (1.0 + std::exp(-x)); }

double checked_settling_count(const IwloParams& p) {
  const auto finite = [](double v) { return std::isfinite(v) && std::abs(v) <= kMaxLogOdds; };
  require(finite(p.L_occ) && p.L_occ >= 0, "L_occ must be a finite number, 0 or more");
  require(finite(p.L_free) && p.L_free <= 0, "L_free must be a finite number, 0 or less");
  require(finite(p.L_min) && p.L_min < 0, "L_min must be a finite number below 0");
  require(finite(p.L_max) && p.L_max > 0, "L_max must be a finite number above 0");
  require(finite(p.sharpness) && p.sharpness >= 0, "sharpness must be a finite number, 0 or more");
  require(finite(p.decay_rate) && p.decay_rate >= 0,
          "decay_rate must be a finite number, 0 or more");
  require(p.min_alpha > 0 && p.min_alpha <= 1, "min_alpha must lie in (0, 1]");
  require(std::isfinite(p.intensity_threshold), "intensity_threshold must be finite");
  require(std::isfinite(p.intensity_max), "intensity_max must be finite");
  require(p.adaptive_threshold > 0 && p.adaptive_threshold <= 1,
          "adaptive_threshold must lie in (0, 1]");
  require(p.adaptive_max_ratio >= 0 && p.adaptive_max_ratio <= 1,
          "adaptive_max_ratio must lie in [0, 1]");
  if (p.decay_rate == 0 || p.min_alpha == 1) return 1.0;
  // At least 1: a count of 0 means "never observed".
  const double settled = std::max(1.0, std::ceil((1.0 / p.min_alpha - 1.0) / p.decay_rate));
  require(settled <= kMaxCount, "decay_rate " + std::to_string(p.decay_rate) + " and min_alpha " +
                                    std::to_string(p.min_alpha) +
                                    " need more than 65535 pings to settle: raise either of them");
  return settled;
}

}  // namespace

IwloRule::IwloRule(const IwloParams& params) : params_(params) {
  const double settled = checked_settling_count(params);
  alpha_.reserve(static_cast<std::size_t>(settled) + 1);
  for (double n = 0; n <= settled; ++n) {
    alpha_.push_back(std::max(params_.min_alpha, 1.0 / (1.0 + params_.decay_rate * n)));
  }
}

double IwloRule::alpha(std::uint16_t count) const {
  return alpha_[std::min<std::size_t>(count, alpha_.size() - 1)];
}

double IwloRule::occupied_weight(double intensity) const {
  if (!is_return(intensity)) return 0.0;
  const double span = params_.intensity_max - params_.intensity_threshold;
  const double x =
      span <= 1e-9 ? 1.0 : std::clamp((intensity - params_.intensity_threshold) / span, 0.0, 1.0);
  return sigmoid(params_.sharpness * (x - 0.5));
}

double IwloRule::occupied_step(double log_odds, std::uint16_t count, double weight) const {
  double scale = 1.0;
  if (params_.adaptive_update) {
    const double p = sigmoid(log_odds);
    if (p < params_.adaptive_threshold) {
      scale = p / params_.adaptive_threshold * params_.adaptive_max_ratio;
    }
  }
  return params_.L_occ * weight * alpha(count) * scale;
}

double IwloRule::free_step(double log_odds, std::uint16_t count) const {
  double scale = 1.0;
  if (params_.adaptive_update && params_.protect_occupied) {
    const double p = sigmoid(log_odds);
    const double excess = p - (1.0 - params_.adaptive_threshold);
    if (excess > 0) {
      const double f = excess / params_.adaptive_threshold;
      scale = params_.adaptive_max_ratio + (1.0 - params_.adaptive_max_ratio) * (1.0 - f);
    }
  }
  return params_.L_free * alpha(count) * scale;
}

void IwloRule::apply(double step, float& log_odds, std::uint16_t& count) const {
  const double updated = static_cast<double>(log_odds) + step;
  log_odds = static_cast<float>(std::clamp(updated, params_.L_min, params_.L_max));
  if (count < settled_count()) ++count;
}

}  // namespace mapperd
