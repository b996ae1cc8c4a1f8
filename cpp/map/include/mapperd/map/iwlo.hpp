// The Intensity-Weighted Log-Odds rule: the one place where evidence becomes log-odds.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mapperd::map {

// Names and defaults are those of the published sonar mapper that this project grew from.
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
  // Below the adaptive threshold, the least that alpha times the scale may be for an occupied step.
  // 0 is the published rule, by which a voxel seen free five times stays so for 210 000 pings.
  double adaptive_min_ratio = 0.25;
  bool protect_occupied = true;  // false: free steps are never scaled down
};

// Log-odds are held in whole units of 2^-24. Sums of whole numbers do not depend on their order,
// so free steps that are kept pending, or applied to many voxels at once, give the same bits as
// free steps applied one by one. 32 bits reach to +-127.
inline constexpr double kLogOddsUnit = 0x1p-24;
inline constexpr double kMaxLogOdds = 127.0;

inline double log_odds_of(std::int32_t units) { return kLogOddsUnit * units; }
inline std::int32_t units_of(double log_odds) {
  return static_cast<std::int32_t>(std::lround(log_odds / kLogOddsUnit));
}

class IwloRule {
 public:
  // Throws std::invalid_argument, naming the parameter, for values that are not finite, out of
  // range, or that need more than 65535 pings to settle; for a min_ratio above the max_ratio.
  explicit IwloRule(const IwloParams& params);

  const IwloParams& params() const { return params_; }

  // The one constant that may change: no table depends on it, and no voxel remembers it.
  // Throws std::invalid_argument if it is not finite.
  void set_intensity_threshold(double intensity);

  // Observations after which alpha no longer changes: counts stop there without loss.
  std::uint16_t settled_count() const { return static_cast<std::uint16_t>(alpha_.size() - 1); }

  bool is_return(double intensity) const { return intensity > params_.intensity_threshold; }

  // w(I): 0 at or below the threshold, else the sigmoid of the normalised intensity.
  double occupied_weight(double intensity) const;

  // Log-odds steps of a voxel in state (log_odds, count).
  double occupied_step(double log_odds, std::uint16_t count, double weight) const;
  double free_step(double log_odds, std::uint16_t count) const;

  // Adds a step, clamps, and counts the observation.
  void add(double step, std::int32_t& units, std::uint16_t& count) const;

  // One free step; the same as `times` = 1 below, but for any voxel.
  void add_free(std::int32_t& units, std::uint16_t& count) const {
    if (is_unscaled(units)) {
      add_unscaled_free(units, count, 1);
    } else {
      add(free_step(log_odds_of(units), count), units, count);
    }
  }

  // Below this the free step does not depend on the log-odds, and free steps telescope.
  bool is_unscaled(std::int32_t units) const { return units <= unscaled_up_to_; }
  void add_unscaled_free(std::int32_t& units, std::uint16_t& count, std::uint32_t times) const;

  // What so many unscaled free steps do to a voxel, by its count: by how many units they lower it
  // (those that lower any voxel to the clamp are all alike) and the count after them.
  struct FreeSteps {
    std::vector<std::uint32_t> down;
    std::vector<std::uint32_t> count;
  };
  FreeSteps free_steps(std::uint32_t times) const;
  const FreeSteps& one_free_step() const { return one_free_step_; }
  std::int32_t unscaled_up_to() const { return unscaled_up_to_; }

  // After so many free steps without a scale every voxel is at L_min and counted out.
  std::uint32_t free_steps_to_floor() const { return free_steps_to_floor_; }

  std::size_t memory_bytes() const;  // of its tables

  std::int32_t min_units() const { return min_units_; }
  std::int32_t max_units() const { return max_units_; }
  std::int32_t clamped(std::int64_t units) const {
    return static_cast<std::int32_t>(std::clamp<std::int64_t>(units, min_units_, max_units_));
  }

 private:
  double alpha(std::uint16_t count) const;

  IwloParams params_;
  std::vector<double> alpha_;  // by count, up to the settled count
  std::int32_t min_units_;
  std::int32_t max_units_;
  std::int32_t unscaled_up_to_;
  std::int64_t settled_free_step_;  // units a ping once alpha has settled
  std::uint32_t free_steps_to_floor_;
  std::vector<std::int64_t> free_steps_sum_;  // of the first n free steps, n up to settled
  FreeSteps one_free_step_;
};

}  // namespace mapperd::map
