// The Intensity-Weighted Log-Odds rule: the one place where evidence becomes log-odds.
#pragma once

#include <cstdint>
#include <vector>

namespace mapperd {

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
  bool protect_occupied = true;  // false: free steps are never scaled down
};

// What one ping says about one voxel.
enum class Evidence : std::uint8_t { none, free, occupied, mixed };

class IwloRule {
 public:
  // Throws std::invalid_argument, naming the parameter, for values that are not finite, out of
  // range, or that need more than 65535 pings to settle.
  explicit IwloRule(const IwloParams& params);

  const IwloParams& params() const { return params_; }

  // Observations after which alpha no longer changes: counts stop there without loss.
  std::uint16_t settled_count() const { return static_cast<std::uint16_t>(alpha_.size() - 1); }

  bool is_return(double intensity) const { return intensity > params_.intensity_threshold; }

  // w(I): 0 at or below the threshold, else the sigmoid of the normalised intensity.
  double occupied_weight(double intensity) const;

  // Log-odds steps of a voxel in state (log_odds, count).
  double occupied_step(double log_odds, std::uint16_t count, double weight) const;
  double free_step(double log_odds, std::uint16_t count) const;

  // Adds a step, clamps, and counts the observation. Float32 holds the state: its resolution at
  // the clamps (1e-6) is a hundredth of the accuracy asked of the integrators.
  void apply(double step, float& log_odds, std::uint16_t& count) const;

 private:
  double alpha(std::uint16_t count) const;

  IwloParams params_;
  std::vector<double> alpha_;  // by count, up to the settled count
};

}  // namespace mapperd
