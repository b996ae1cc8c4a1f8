/// \file
/// \brief Log-likelihoods of particles, from measured and expected ranges (the beam model).
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/range_map.hpp"

namespace mapperd::localization {

/// The mixture of hits (a Gaussian cut to 0 ... max_range), short readings (an exponential cut to
/// the expected range), random readings and readings at max_range.
struct BeamModel {
  double z_hit = 0.5;
  double z_short = 0.05;
  double z_max = 0.05;
  double z_rand = 0.5;
  double sigma_hit_m = 0.2;
  double lambda_short_per_m = 0.1;
  double max_range_m = 100.0;

  /// Density of a measured range given the expected one, 1/m.
  double density(double range_m, double expected_m) const;
  /// Density without an expected range, 1/m: the random term alone.
  double background() const;
};

/// \throws std::invalid_argument for values out of range.
void check_beam_model(const BeamModel& model);

/// Beams of a sensor with a given position in the base frame.
struct Beams {
  double sensor_x_m = 0.0;
  double sensor_y_m = 0.0;
  std::vector<double> bearing_rad;  ///< in the base frame, counter-clockwise
  std::vector<double> range_m;      ///< max_range or more: no return
  std::vector<double> quality;      ///< 0 ... 1: p becomes q p + (1 - q) background

  std::size_t size() const { return bearing_rad.size(); }
};

/// \throws std::invalid_argument for arrays that do not fit together or are not finite.
void check_beams(const Beams& beams);

/// Writes the log-likelihoods of particles first ... last - 1 to out[first] ... out[last - 1]: ln
/// sum p^3 or kappa sum ln p.
void beam_log_likelihoods(const RangeMap& map, const Beams& beams, const BeamModel& model,
                          BeamAggregation aggregation, double kappa, const Particles& particles,
                          std::size_t first, std::size_t last, double* out);

}  // namespace mapperd::localization
