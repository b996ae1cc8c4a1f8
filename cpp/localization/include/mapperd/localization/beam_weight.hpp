// What a scan says of each particle, by the ranges that the map lets one expect.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/range_map.hpp"

namespace mapperd::localization {

// The mixture of hits (a Gaussian cut to 0 ... max_range), short readings (an exponential cut to
// the expected range), random readings and readings at max_range.
struct BeamModel {
  double z_hit = 0.5;
  double z_short = 0.05;
  double z_max = 0.05;
  double z_rand = 0.5;
  double sigma_hit_m = 0.2;
  double lambda_short_per_m = 0.1;
  double max_range_m = 100.0;

  // p of a measured range where another is expected, in 1/m.
  double density(double range_m, double expected_m) const;
  // p where nothing is expected: the random term alone.
  double background() const;
};

// Throws std::invalid_argument for values without meaning.
void check_beam_model(const BeamModel& model);

// Beams as seen from the sensor, which stands in the base frame.
struct Beams {
  double sensor_x_m = 0.0;
  double sensor_y_m = 0.0;
  std::vector<double> bearing_rad;  // in the base frame, counter-clockwise
  std::vector<double> range_m;      // max_range and more: nothing came back
  std::vector<double> quality;      // 0 ... 1: p becomes q p + (1 - q) background

  std::size_t size() const { return bearing_rad.size(); }
};

// Throws std::invalid_argument for arrays that do not fit together or are not finite.
void check_beams(const Beams& beams);

// Log-likelihoods of particles first ... last - 1, at their places in `out`: ln sum p^3 or
// kappa sum ln p.
void beam_log_likelihoods(const RangeMap& map, const Beams& beams, const BeamModel& model,
                          BeamAggregation aggregation, double kappa, const Particles& particles,
                          std::size_t first, std::size_t last, double* out);

}  // namespace mapperd::localization
