#include "mapperd/map/iwlo.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "mapperd/common/memory_use.hpp"

namespace mapperd::map {
namespace {

constexpr double kMaxCount = 65535.0;

void require(bool ok, const std::string& what) {
  if (!ok) throw std::invalid_argument(what);
}

double sigmoid(double x) { return 1.0 / (1.0 + std::exp(-x)); }

double checked_settling_count(const IwloParams& p) {
  const auto finite = [](double v) { return std::isfinite(v) && std::abs(v) <= kMaxLogOdds; };
  require(finite(p.L_occ) && p.L_occ >= 0,
          "L_occ must be a number, 0 or more, of at most 127 in size");
  require(finite(p.L_free) && p.L_free <= 0,
          "L_free must be a number, 0 or less, of at most 127 in size");
  require(finite(p.L_min) && p.L_min < 0, "L_min must be a number below 0, of at most 127 in size");
  require(finite(p.L_max) && p.L_max > 0, "L_max must be a number above 0, of at most 127 in size");
  require(p.sharpness >= 0 && p.sharpness <= 1e4, "sharpness must be a number from 0 to 10000");
  require(p.decay_rate >= 0 && p.decay_rate <= 1e4, "decay_rate must be a number from 0 to 10000");
  require(p.min_alpha > 0 && p.min_alpha <= 1, "min_alpha must lie in (0, 1]");
  require(std::isfinite(p.intensity_threshold), "intensity_threshold must be finite");
  require(std::isfinite(p.intensity_max), "intensity_max must be finite");
  require(p.adaptive_threshold > 0 && p.adaptive_threshold <= 1,
          "adaptive_threshold must lie in (0, 1]");
  require(p.adaptive_max_ratio >= 0 && p.adaptive_max_ratio <= 1,
          "adaptive_max_ratio must lie in [0, 1]");
  require(p.adaptive_min_ratio >= 0 && p.adaptive_min_ratio <= p.adaptive_max_ratio,
          "adaptive_min_ratio " + std::to_string(p.adaptive_min_ratio) +
              " must lie between 0 and adaptive_max_ratio " + std::to_string(p.adaptive_max_ratio));
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
  min_units_ = units_of(params.L_min);
  max_units_ = units_of(params.L_max);
  // Free steps are scaled down above p = 1 - adaptive.threshold.
  const double p = 1.0 - params.adaptive_threshold;
  const bool scales = params.adaptive_update && params.protect_occupied;
  const double limit = scales ? (p > 0 ? std::log(p / (1.0 - p)) : -kMaxLogOdds) : kMaxLogOdds;
  unscaled_up_to_ = units_of(std::clamp(limit, -kMaxLogOdds, kMaxLogOdds));
  const auto free_units = [this](double a) {
    return std::llround(params_.L_free * a / kLogOddsUnit);
  };
  free_steps_sum_.reserve(alpha_.size() + 1);
  free_steps_sum_.push_back(0);
  for (const double a : alpha_) free_steps_sum_.push_back(free_steps_sum_.back() + free_units(a));
  free_steps_sum_.pop_back();
  settled_free_step_ = free_units(alpha_.back());
  one_free_step_ = free_steps(1);
  free_steps_to_floor_ = std::numeric_limits<std::uint32_t>::max();
  if (settled_free_step_ < 0) {
    const std::int64_t span = std::int64_t{max_units_} - min_units_;
    const std::int64_t steps = settled_count() + span / -settled_free_step_ + 1;
    free_steps_to_floor_ =
        static_cast<std::uint32_t>(std::min<std::int64_t>(steps, free_steps_to_floor_));
  }
}

IwloRule::FreeSteps IwloRule::free_steps(std::uint32_t times) const {
  constexpr std::int64_t kMost = 0xFFFFFFFF;  // more than any voxel is above its clamp
  const auto settled = static_cast<std::uint32_t>(settled_count());
  FreeSteps steps;
  steps.down.reserve(settled + 1);
  steps.count.reserve(settled + 1);
  for (std::uint32_t count = 0; count <= settled; ++count) {
    const std::uint32_t learning = std::min(times, settled - count);
    const std::int64_t sum = free_steps_sum_[count] - free_steps_sum_[count + learning] -
                             static_cast<std::int64_t>(times - learning) * settled_free_step_;
    steps.down.push_back(static_cast<std::uint32_t>(std::min(sum, kMost)));
    steps.count.push_back(count + learning);
  }
  return steps;
}

void IwloRule::set_intensity_threshold(double intensity) {
  require(std::isfinite(intensity), "intensity_threshold must be finite");
  params_.intensity_threshold = intensity;
}

std::size_t IwloRule::memory_bytes() const {
  return allocated_by(alpha_) + allocated_by(free_steps_sum_) + allocated_by(one_free_step_.down) +
         allocated_by(one_free_step_.count);
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
  const double full = params_.L_occ * weight;
  const double p = sigmoid(log_odds);
  if (!params_.adaptive_update || p >= params_.adaptive_threshold) return full * alpha(count);
  const double scale = p / params_.adaptive_threshold * params_.adaptive_max_ratio;
  // The floor holds for the rate and not for the scale alone: alpha, once settled, would else make
  // the way back from L_min long again.
  return std::max(full * alpha(count) * scale, full * params_.adaptive_min_ratio);
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

void IwloRule::add(double step, std::int32_t& units, std::uint16_t& count) const {
  const std::int64_t updated = units + static_cast<std::int64_t>(std::llrint(step / kLogOddsUnit));
  units = clamped(updated);
  if (count < settled_count()) ++count;
}

void IwloRule::add_unscaled_free(std::int32_t& units, std::uint16_t& count,
                                 std::uint32_t times) const {
  const auto settled = static_cast<std::uint32_t>(settled_count());
  const auto before = std::min<std::uint32_t>(count, settled);
  const std::uint32_t learning = std::min(times, settled - before);
  const std::int64_t step = free_steps_sum_[before + learning] - free_steps_sum_[before] +
                            static_cast<std::int64_t>(times - learning) * settled_free_step_;
  // All steps go down, so that clamping once at the end is clamping at each.
  units = static_cast<std::int32_t>(std::max<std::int64_t>(units + step, min_units_));
  count = static_cast<std::uint16_t>(before + learning);
}

}  // namespace mapperd::map
