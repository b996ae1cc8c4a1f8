/// \file
/// \brief The particle filter: one cloud that is moved, weighted and resampled.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "mapperd/localization/beam_weight.hpp"
#include "mapperd/localization/clusters.hpp"
#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/log_weights.hpp"
#include "mapperd/localization/motion.hpp"
#include "mapperd/localization/recovery.hpp"
#include "mapperd/localization/resample.hpp"
#include "mapperd/localization/scan_search.hpp"

namespace mapperd::localization {

/// Parameters of a particle filter.
struct FilterParams {
  ResampleParams resample;
  double alpha_slow = 0.0;            ///< gain of the slow average weight, 0 ... alpha_fast
  double alpha_fast = 0.0;            ///< gain of the fast one, up to 1; both 0: no recovery
  std::size_t resample_interval = 1;  ///< in updates
  bool selective = false;             ///< only when the effective size is below half the particles
  double max_step_m = 1e6;            ///< longer steps of odometry are refused, m
  /// A scan's likelihoods are raised to a power below 1 where else less than this share of the
  /// effective size was left: 0 never. A scan that a cloud is too sparse for must not choose a
  /// mode.
  double least_effective_share = 0.0;
  /// Draws go by weights to this power, and children keep the rest of the weight: below 1 light
  /// modes keep particles. 1 draws as AMCL does.
  double draw_exponent = 1.0;
};

/// \throws std::invalid_argument for values out of range.
void check_filter_rule(const FilterParams& rule);

/// Counters since the start.
struct FilterCounts {
  std::uint64_t updates = 0;
  std::uint64_t resamplings = 0;
  std::uint64_t injected_particles = 0;
  std::uint64_t refused_steps = 0;        ///< odometry not finite, or a jump
  std::uint64_t empty_scans = 0;          ///< moved, not weighted
  std::uint64_t uninformative_scans = 0;  ///< every likelihood 0: weights kept
  std::uint64_t not_a_number = 0;         ///< likelihoods that were no number
};

/// Result of weighting the cloud by a scan.
struct Weighed {
  bool informative = false;
  double log_evidence = 0.0;    ///< of the likelihoods as they came
  double fit = 0.0;             ///< mean likelihood of one beam, whatever the number of particles
  double injected_share = 0.0;  ///< of the next resampling
  double exponent = 1.0;        ///< exponent applied to the likelihoods
};

/// Complete state of a filter: another one with the same rule continues from it bit-exactly.
struct FilterState {
  Particles particles;
  std::uint64_t seed = 0;
  std::uint64_t step = 0;
  std::size_t updates_since_start = 0;
  Recovery::Averages averages;
  FilterCounts counts;
};

/// How a scan's likelihood was computed, from which the fit per beam follows.
enum class FitKind { kCubeSumFromOne, kCubeSum, kProduct };

/// All random numbers belong to (seed, step, particle): a run repeats exactly, whatever the number
/// of threads. Not to be used from two threads at once.
class ParticleFilter {
 public:
  ParticleFilter(const FilterParams& rule, std::uint64_t seed, int threads);

  const Particles& particles() const { return particles_; }
  const FilterParams& rule() const { return rule_; }
  const FilterCounts& counts() const { return counts_; }
  std::uint64_t seed() const { return seed_; }

  /// Replaces the rule and keeps the cloud; the number of particles changes at the next resampling.
  void set_rule(const FilterParams& rule);
  void set_threads(int threads);

  /// Starts with a new cloud of max_particles, or with the one given; resets the averages and the
  /// interval.
  void start_about(const Pose2& mean, const Matrix3& covariance);
  void start_anywhere(const FreeSpace& free);
  void start_with(Particles particles);
  /// Starts with max_particles drawn by weight from `search` random poses, weighted by the scan.
  /// \throws std::invalid_argument if `search` has fewer poses than particles.
  void start_by_scan(const FreeSpace& free, const LikelihoodField& field, const Endpoints& ends,
                     const Search& search);

  FilterState state() const;
  /// \throws std::invalid_argument for a state that no filter can have; nothing changes then.
  void restore(FilterState state);

  /// Moves the cloud by the step from `before` to `now` (odometry frame). Returns false if it
  /// refuses the step: keep `before` then.
  bool predict(const Pose2& before, const Pose2& now, MotionModel model, const Alphas& alphas,
               const MotionFloor& floor);

  Weighed weigh(const LikelihoodField& field, const Endpoints& ends, BeamAggregation aggregation,
                double kappa);
  Weighed weigh(const RangeMap& map, const Beams& beams, const BeamModel& model,
                BeamAggregation aggregation, double kappa);
  /// Weights the cloud by given log-likelihoods of `beams` beams.
  Weighed weigh(const std::vector<double>& log_likelihood, std::size_t beams, FitKind kind,
                double kappa);

  /// Resamples when the interval has passed and the effective size is below its limit. `free` may
  /// be nullptr: no recovery.
  bool resample_if_due(const FreeSpace* free);
  void resample(const FreeSpace* free);

  double effective_size() const;
  Estimate estimate() const;
  Clusters clusters(const ClusterParams& rule) const;
  std::vector<double> weights() const { return linear_weights(particles_.log_weight); }

 private:
  template <typename Task>
  void in_blocks(const Task& task) const;
  Stream next_stream() { return {seed_, ++step_}; }
  void begin();
  std::vector<double> draw_weights() const;
  double log_of_mean_kept(const std::vector<double>& draw_weight) const;
  bool fits_one_bucket(const Estimate& estimate) const;

  FilterParams rule_;
  std::uint64_t seed_;
  int threads_;
  std::uint64_t step_ = 0;
  std::size_t updates_since_start_ = 0;
  Particles particles_;
  Recovery recovery_;
  FilterCounts counts_;
};

}  // namespace mapperd::localization
