/// \file
/// \brief Updates of single points, for programs with their own sensor model. Points are checked
/// before the first is taken: a call changes all of them or nothing. A voxel named twice is updated
/// twice, in the order of the points.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <cstddef>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Limits of the log-odds: a step stops at a limit, and never moves a voxel beyond it back.
struct StepLimits {
  double low = 0.0;
  double high = 0.0;
};

/// Points with their observations, one array per quantity; borrowed.
struct ObservedPoints {
  Points points;
  const double* intensity = nullptr;  ///< 0 .. intensity_max; used where occupied
  const bool* occupied = nullptr;
  const double* step_factor = nullptr;  ///< 0 or more; nullptr: 1 everywhere
};

// All throw std::invalid_argument, naming the row, for numbers that are not finite and points
/// beyond the map's reach.

/// Adds one observation per point with the map's rule. The factor scales the step, not the count.
void observe(VoxelMap& map, const ObservedPoints& observed);

/// Adds steps to the log-odds; counts one observation each.
void add_log_odds(VoxelMap& map, const Points& points, const double* steps,
                  const StepLimits& limits);

/// Sets the log-odds, within the map's clamps; counts one observation each.
void set_log_odds(VoxelMap& map, const Points& points, const double* values);

/// Adds `miss` (log-odds) to the voxels along a segment of the map frame, m, and `hit` to its last
/// one.
void add_ray(VoxelMap& map, const Vec3& origin_m, const Vec3& end_m, double hit, double miss,
             const StepLimits& limits);

}  // namespace mapperd::map
