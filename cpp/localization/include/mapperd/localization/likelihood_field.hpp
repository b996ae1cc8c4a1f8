/// \file
/// \brief The likelihood field: density p(d) of a return at distance d from the nearest obstacle,
/// for each cell of a map.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "mapperd/localization/grid.hpp"

namespace mapperd::localization {

/// p(d) = z_hit / (sigma sqrt(2 pi)) exp(-d^2 / (2 sigma^2)) + z_rand / max_range: a density in
/// 1/m, above 1 where sigma is small. Distances count up to max_distance_m.
struct HitModel {
  double z_hit = 0.5;
  double z_rand = 0.5;
  double sigma_hit_m = 0.2;
  double max_range_m = 100.0;
  double max_distance_m = 2.0;

  double density(double distance_m) const;
};

/// \throws std::invalid_argument for negative or not finite values, and where nothing is left of p.
void check_hit_model(const HitModel& model);

/// How unknown cells weigh an end point.
enum class UnknownSpace {
  kAsFree,      ///< only its distance to obstacles counts
  kBackground,  ///< p at max_distance_m
  kUniform,     ///< 1 / max_range: the reference's `model_unknown_space`, which draws poses outward
};

/// Which cells reflect, and what unknown ones count as.
struct ObstacleParams {
  bool only_boundaries = false;  ///< occupied cells with a free one at a side; the rest is far
  UnknownSpace unknown = UnknownSpace::kAsFree;
};

/// One or more layers of cells, each with a border of one cell that stands for all that lies
/// outside: there p is that of max_distance_m, as in mapped water far from everything, or the value
/// given. Values below 1e-12 of the largest are raised to that: no product is ever 0.
class LikelihoodField {
 public:
  LikelihoodField(const OccupancyGrid& grid, const HitModel& model, const ObstacleParams& rule,
                  int threads);
  /// Takes given values, row-major.
  LikelihoodField(const GridFrame& frame, const std::vector<float>& values, double outside);
  /// Computes the field from distances on a lattice of x, y, z, z fastest, as distance_field()
  /// returns them. `first_centre` is in the map frame.
  LikelihoodField(const std::vector<float>& distances_m, const std::array<std::size_t, 3>& size,
                  const std::array<double, 3>& first_centre_m, double resolution_m,
                  const HitModel& model);

  const GridFrame& frame() const { return frame_; }
  double background() const { return background_; }  ///< density at an unknown place, 1/m
  bool is_flat() const { return flat_; }
  std::size_t layers() const { return layers_; }
  /// Returns the index of the first value of the layer at a height of the map frame, m; a flat
  /// field has one layer for all heights.
  std::int32_t layer_at(double z_m) const;
  const float* values() const { return values_.data(); }
  std::int32_t stride() const { return static_cast<std::int32_t>(frame_.columns + 2); }
  float at(std::size_t layer, std::size_t row, std::size_t column) const;
  std::size_t memory_bytes() const { return values_.size() * sizeof(float); }

 private:
  void set_outside(double value);
  void allocate(std::size_t layers);
  void raise_to_floor();
  std::size_t layer_cells() const { return (frame_.rows + 2) * (frame_.columns + 2); }
  float* row(std::size_t layer, std::size_t row);

  GridFrame frame_;
  bool flat_ = true;
  std::size_t layers_ = 1;
  double lowest_z_m_ = 0.0;
  double background_ = 0.0;
  float outside_ = 0.0F;
  std::vector<float> values_;  ///< layers, and one more that is all outside
};

}  // namespace mapperd::localization
