// Evidence about single points, for programs that bring their own sensor model. Points are checked
// before the first is taken: a call changes all of them or nothing. A voxel named twice is updated
// twice, in the order of the points.
#pragma once

#include <cstddef>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

// Limits that steps do not cross: they stop there, but never bring a voxel back that is beyond.
struct StepLimits {
  double low = 0.0;
  double high = 0.0;
};

struct ObservedPoints {
  Points points;
  const double* intensity = nullptr;  // 0 .. intensity_max; used where occupied
  const bool* occupied = nullptr;
  const double* step_factor = nullptr;  // 0 or more; nullptr: 1 everywhere
};

// All throw std::invalid_argument, naming the row, for numbers that are not finite and points
// beyond the map's reach.

// One IWLO observation a point, by the map's rule; the step is multiplied by the factor, which
// plays no part in the count.
void observe(VoxelMap& map, const ObservedPoints& observed);

// L + step, one observation more.
void add_log_odds(VoxelMap& map, const Points& points, const double* steps,
                  const StepLimits& limits);

// L becomes the value, inside the map's clamps; one observation more.
void set_log_odds(VoxelMap& map, const Points& points, const double* values);

// `miss` for the voxels that the segment runs through, `hit` for the one that it ends in.
void add_ray(VoxelMap& map, const Vec3& origin_m, const Vec3& end_m, double hit, double miss,
             const StepLimits& limits);

}  // namespace mapperd::map
