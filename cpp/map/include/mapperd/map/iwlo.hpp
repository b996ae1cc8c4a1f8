/// \file
/// \brief The Intensity-Weighted Log-Odds rule: the one place where evidence becomes log-odds.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/kernels.hpp"

namespace mapperd::map {

/// Log-odds, unless noted. Names and defaults are those of sonar_3d_reconstruction.
struct IwloParams {
  double L_occ = 3.5;
  double L_free = -3.0;
  double L_min = -10.0;
  double L_max = 10.0;
  double sharpness = 3.0;
  double decay_rate = 0.1;
  double min_alpha = 0.1;
  double intensity_threshold = 35.0;
  double intensity_max = 255.0;
  bool adaptive_update = true;
  double adaptive_threshold = 0.5;
  double adaptive_max_ratio = 0.3;
  /// Below the adaptive threshold, the lower limit of alpha times the scale for an occupied step. 0
  /// is the original rule, by which a voxel seen free five times stays so for 210 000 pings; here
  /// it stays so for ever, because steps below half a unit are lost.
  double adaptive_min_ratio = 0.25;
  bool protect_occupied = true;  ///< false: free steps are never scaled down
  /// Log-odds of an unobserved voxel. The map holds the evidence of the pings, which is added to
  /// it; all parameters above, clamps and scales included, are of that evidence.
  double prior = 0.0;
};

inline constexpr double kMaxLogOdds = 127.0;

/// Outside the map (files, Python) log-odds are whole numbers of 2^-24.
inline constexpr double kLogOddsUnit = 0x1p-24;
inline std::int32_t file_units_of(double log_odds) {
  return static_cast<std::int32_t>(std::lround(log_odds / kLogOddsUnit));
}
inline double log_odds_of(std::int32_t file_units) { return kLogOddsUnit * file_units; }

/// a b / 2^15, rounded half up: what pmulhrsw of SSSE3 and sqrdmulh of NEON compute.
inline std::int16_t multiply_q15(std::int16_t a, std::int16_t b) {
  return static_cast<std::int16_t>((std::int32_t{a} * b + 0x4000) >> 15);
}
inline constexpr std::int16_t kOneQ15 = 32767;

/// The map holds log-odds in 16 bits, in units of 2^-shift: 2^-11 for clamps within +-15, coarser
/// ones for wider clamps. Every step is a whole number of units that depends on the voxel's state
/// alone. Sums of whole numbers do not depend on their order, so free steps that are kept pending,
/// or applied to many voxels at once, give the same bits as free steps applied one by one.
class IwloRule {
 public:
  /// \throws std::invalid_argument, naming the parameter, for values that are not finite, out of
  /// range, or that need more than 65535 pings to settle; for a min_ratio above the max_ratio.
  explicit IwloRule(const IwloParams& params);

  const IwloParams& params() const { return params_; }

  /// The one constant that may change: no table depends on it, and no voxel remembers it.
  /// \throws std::invalid_argument if it is not finite.
  void set_intensity_threshold(double intensity);

  /// Observations after which alpha no longer changes: counts stop there without loss.
  std::uint16_t settled_count() const { return static_cast<std::uint16_t>(alpha_.size() - 1); }
  /// Bytes of a count: 1 where counts stop below 256, else 2.
  int count_bytes() const { return settled_count() < 256 ? 1 : 2; }

  bool is_return(double intensity) const { return intensity > params_.intensity_threshold; }

  /// w(I): 0 at or below the threshold, else the sigmoid of the normalised intensity.
  double occupied_weight(double intensity) const;
  /// Limits of the weights; codes 2 to 255 divide the interval evenly.
  double min_weight() const { return min_weight_; }
  double largest_weight() const { return largest_weight_; }

  /// The rule in log-odds: steps of a voxel in state (log_odds, count).
  double occupied_step(double log_odds, std::uint16_t count, double weight) const;
  double free_step(double log_odds, std::uint16_t count) const;

  /// The same in units of the map.
  int shift() const { return shift_; }
  double unit() const { return std::ldexp(1.0, -shift_); }
  double log_odds(std::int16_t units) const { return unit() * units + params_.prior; }
  std::int16_t units(double log_odds) const {  ///< clamped
    const double evidence = std::clamp(log_odds - params_.prior, -1e3, 1e3);
    return clamped(std::llrint(std::ldexp(evidence, shift_)));
  }
  std::int32_t file_units(std::int16_t units) const {
    return std::int32_t{units} * (1 << (24 - shift_));
  }
  /// Rounded, not clamped.
  std::int64_t units_of_file(std::int32_t units) const {
    const int bits = 24 - shift_;
    return (std::int64_t{units} + (std::int64_t{1} << (bits - 1))) >> bits;
  }
  std::int16_t min_units() const { return min_units_; }
  std::int16_t max_units() const { return max_units_; }
  std::int16_t clamped(std::int64_t units) const {
    return static_cast<std::int16_t>(std::clamp<std::int64_t>(units, min_units_, max_units_));
  }

  /// An occupied step before alpha and scale.
  std::int16_t full_step(double weight) const {
    const double step = std::min(params_.L_occ * weight, params_.L_max - params_.L_min);
    return static_cast<std::int16_t>(std::lround(std::ldexp(step, shift_)));
  }
  std::int16_t full_step_of_code(std::uint8_t code) const {
    const auto place = static_cast<std::int16_t>((code - kCodeOccupied) << 7);
    return static_cast<std::int16_t>(code_base_ + multiply_q15(place, code_slope_));
  }
  std::int16_t occupied_units(std::int16_t units, std::uint16_t count, std::int16_t full) const {
    const std::int16_t alpha = alpha_[count];
    if (units >= occupied_unscaled_from_) return multiply_q15(full, alpha);
    return multiply_q15(
        full, std::max(multiply_q15(alpha, occupied_scale_[scale_index(units)]), min_ratio_));
  }
  /// Positive: by how much a free step lowers a voxel.
  std::int16_t free_units(std::int16_t units, std::uint16_t count) const {
    const std::int16_t down = multiply_q15(full_free_, alpha_[count]);
    return units <= unscaled_up_to_ ? down : multiply_q15(down, free_scale_[scale_index(units)]);
  }

  /// A step downwards, as positive units, as small as the adaptive rule makes it for a voxel.
  std::int16_t scaled_down(std::int16_t units, std::int16_t down) const {
    return units <= unscaled_up_to_ ? down : multiply_q15(down, free_scale_[scale_index(units)]);
  }

  /// Adds a step, clamps, and counts the observation.
  void add(std::int64_t step, std::int16_t& units, std::uint16_t& count) const {
    units = clamped(units + step);
    if (count < settled_count()) ++count;
  }
  void add_free(std::int16_t& units, std::uint16_t& count) const {
    add(-std::int64_t{free_units(units, count)}, units, count);
  }

  /// Up to here the free step does not depend on the log-odds, and free steps telescope.
  std::int16_t unscaled_up_to() const { return unscaled_up_to_; }
  void add_unscaled_free(std::int16_t& units, std::uint16_t& count, std::uint32_t times) const;

  /// After so many free steps without a scale every voxel is at L_min and counted out.
  std::uint32_t free_steps_to_floor() const { return free_steps_to_floor_; }

  RuleTables tables() const;

  std::size_t memory_bytes() const;  ///< of its tables

 private:
  std::size_t scale_index(std::int16_t units) const {
    return static_cast<std::size_t>(units - min_units_);
  }
  double alpha(std::uint16_t count) const;
  void fill_scales();

  IwloParams params_;
  double min_weight_;
  double largest_weight_;
  int shift_;
  std::int16_t min_units_;
  std::int16_t max_units_;
  std::int16_t unscaled_up_to_;
  std::int16_t occupied_unscaled_from_;
  std::int16_t min_ratio_;
  std::int16_t full_free_;
  std::int16_t code_base_;
  std::int16_t code_slope_;
  std::uint32_t free_steps_to_floor_;
  std::vector<std::int16_t> alpha_;           ///< by count, up to the settled count
  std::vector<std::int64_t> free_steps_sum_;  ///< of the first n free steps, n up to settled
  std::vector<std::int16_t> occupied_scale_;
  std::vector<std::int16_t> free_scale_;
};

}  // namespace mapperd::map
