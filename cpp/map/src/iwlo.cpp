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
constexpr double kLargestUnits = 32512;  // 127 in units of 2^-8

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
  require(finite(p.prior), "prior must be a number of at most 127 in size");
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

// Units fine enough for 16 bits to hold the clamps and every step that is not clamped anyway.
int finest_shift(const IwloParams& p) {
  const double span = p.L_max - p.L_min;
  const double largest =
      std::max({-p.L_min, p.L_max, std::min(p.L_occ, span), std::min(-p.L_free, span)});
  int shift = 11;
  while (std::ldexp(largest, shift) > kLargestUnits) --shift;
  return shift;
}

std::int16_t q15(double value) {
  return static_cast<std::int16_t>(std::min<long>(std::lround(value * 32768), kOneQ15));
}

}  // namespace

IwloRule::IwloRule(const IwloParams& params) : params_(params) {
  const auto settled = static_cast<std::uint32_t>(checked_settling_count(params));
  shift_ = finest_shift(params_);
  const auto whole = [this](double log_odds) { return std::lround(std::ldexp(log_odds, shift_)); };
  min_units_ = static_cast<std::int16_t>(whole(params_.L_min));
  max_units_ = static_cast<std::int16_t>(whole(params_.L_max));
  full_free_ =
      static_cast<std::int16_t>(whole(std::min(-params_.L_free, params_.L_max - params_.L_min)));
  min_weight_ = sigmoid(-0.5 * params_.sharpness);
  largest_weight_ = sigmoid(0.5 * params_.sharpness);
  code_base_ = full_step(min_weight_);
  // Codes are shifted by 7 bits before they are multiplied.
  code_slope_ = static_cast<std::int16_t>(std::lround((full_step(largest_weight_) - code_base_) *
                                                      32768.0 / ((255 - kCodeOccupied) * 128)));
  min_ratio_ = q15(params_.adaptive_min_ratio);
  // In single precision, as the kernels compute it for many voxels at once.
  const auto decay = static_cast<float>(params_.decay_rate);
  const auto least = static_cast<float>(params_.min_alpha);
  alpha_.reserve(settled + 1);
  for (std::uint32_t n = 0; n <= settled; ++n) {
    const float exact = std::max(least, 1.0F / (1.0F + decay * static_cast<float>(n)));
    const auto rounded = static_cast<std::int32_t>(exact * 32768.0F + 0.5F);
    alpha_.push_back(static_cast<std::int16_t>(std::min<std::int32_t>(rounded, kOneQ15)));
  }
  fill_scales();
  free_steps_sum_.reserve(alpha_.size());
  std::int64_t sum = 0;
  for (const std::int16_t a : alpha_) {
    free_steps_sum_.push_back(sum);
    sum += multiply_q15(full_free_, a);
  }
  const std::int64_t settled_step = multiply_q15(full_free_, alpha_.back());
  free_steps_to_floor_ = std::numeric_limits<std::uint32_t>::max();
  if (settled_step > 0) {
    const std::int64_t steps = settled + (max_units_ - min_units_) / settled_step + 1;
    free_steps_to_floor_ = static_cast<std::uint32_t>(steps);
  }
}

// Free steps are scaled above p = 1 - adaptive.threshold, occupied ones below p = threshold.
void IwloRule::fill_scales() {
  unscaled_up_to_ = max_units_;
  occupied_unscaled_from_ = min_units_;
  if (!params_.adaptive_update) return;
  const double threshold = params_.adaptive_threshold;
  const auto span = static_cast<std::size_t>(max_units_ - min_units_) + 1;
  occupied_scale_.resize(span, kOneQ15);
  free_scale_.resize(span, kOneQ15);
  unscaled_up_to_ = static_cast<std::int16_t>(min_units_ - 1);
  occupied_unscaled_from_ = static_cast<std::int16_t>(max_units_ + 1);
  for (std::size_t i = 0; i < span; ++i) {
    const auto units = static_cast<std::int16_t>(min_units_ + static_cast<std::int32_t>(i));
    const double p = sigmoid(unit() * units);
    const double excess = p - (1.0 - threshold);
    if (p >= threshold) {
      occupied_unscaled_from_ = std::min(occupied_unscaled_from_, units);
    } else {
      occupied_scale_[i] = q15(p / threshold * params_.adaptive_max_ratio);
    }
    if (excess <= 0 || !params_.protect_occupied) {
      unscaled_up_to_ = units;
    } else {
      free_scale_[i] = q15(1.0 - (1.0 - params_.adaptive_max_ratio) * (excess / threshold));
    }
  }
}

RuleTables IwloRule::tables() const {
  return {alpha_.data(),
          occupied_scale_.data(),
          free_scale_.data(),
          static_cast<float>(params_.decay_rate),
          static_cast<float>(params_.min_alpha),
          occupied_unscaled_from_,
          unscaled_up_to_,
          min_ratio_,
          q15(params_.adaptive_max_ratio),
          code_base_,
          code_slope_,
          full_free_,
          min_units_,
          max_units_,
          settled_count()};
}

void IwloRule::set_intensity_threshold(double intensity) {
  require(std::isfinite(intensity), "intensity_threshold must be finite");
  params_.intensity_threshold = intensity;
}

std::size_t IwloRule::memory_bytes() const {
  return allocated_by(alpha_) + allocated_by(free_steps_sum_) + allocated_by(occupied_scale_) +
         allocated_by(free_scale_);
}

double IwloRule::alpha(std::uint16_t count) const {
  return std::max(params_.min_alpha, 1.0 / (1.0 + params_.decay_rate * count));
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

void IwloRule::add_unscaled_free(std::int16_t& units, std::uint16_t& count,
                                 std::uint32_t times) const {
  const std::uint32_t settled = settled_count();
  const std::uint32_t learning = std::min(times, settled - count);
  const std::int64_t down =
      free_steps_sum_[count + learning] - free_steps_sum_[count] +
      std::int64_t{times - learning} * multiply_q15(full_free_, alpha_.back());
  // All steps go down, so that clamping once at the end is clamping at each.
  units = static_cast<std::int16_t>(std::max<std::int64_t>(units - down, min_units_));
  count = static_cast<std::uint16_t>(count + learning);
}

}  // namespace mapperd::map
