/// \file
/// \brief Queries of the map: the class of points and boxes, ray casts.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/voxel_box.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// What is known of a voxel.
enum class Occupancy : std::int8_t { kUnknown = -1, kFree = 0, kOccupied = 1 };

/// Log-odds above which a voxel is occupied and below which it is free. Observed voxels between
/// them are unknown.
struct Thresholds {
  double occupied_log_odds = 0.0;
  double free_log_odds = 0.0;

  Occupancy of(const VoxelState& state) const {
    if (state.count == 0) return Occupancy::kUnknown;
    if (state.log_odds > occupied_log_odds) return Occupancy::kOccupied;
    return state.log_odds < free_log_odds ? Occupancy::kFree : Occupancy::kUnknown;
  }
};

/// \throws std::invalid_argument unless free_log_odds <= occupied_log_odds, both numbers.
void check_thresholds(const Thresholds& thresholds);

/// A view of (N, 3) coordinates in the map frame, m.
struct Points {
  const double* xyz = nullptr;
  std::size_t count = 0;

  Vec3 operator[](std::size_t i) const { return {xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]}; }
};

/// \throws std::invalid_argument, naming the row, unless all coordinates are finite.
void check_finite(const Points& points, const char* name);

/// Returns one class per point; points beyond the map's reach are unknown.
/// \throws std::invalid_argument for coordinates that are not finite.
std::vector<Occupancy> classify(const VoxelMap& map, const Points& points,
                                const Thresholds& thresholds);

/// Returns one class per voxel of the box, z fastest.
/// \throws std::invalid_argument when the box is too large.
std::vector<Occupancy> classify_box(const VoxelMap& map, const VoxelBox& box,
                                    const Thresholds& thresholds);

/// Distances in metres from each origin to where its ray enters the first occupied voxel: 0 where
/// it starts in one, -1 where it meets none within max_range_m. Directions need not be of unit
/// length. Unknown space does not stop a ray.
/// \throws std::invalid_argument, naming the row, for numbers that are not finite, a direction of
/// length 0, an origin beyond the map's reach, or a range of more than kMaxRayVoxels voxels.
std::vector<double> ray_cast_depth(const VoxelMap& map, const Points& origins,
                                   const Points& directions, double max_range_m,
                                   double occupied_log_odds);

/// An observed voxel and its state.
struct KnownVoxel {
  VoxelIndex voxel;
  VoxelState state;
};

/// Returns the occupied voxels of a box of any size, in the map's canonical order.
std::vector<KnownVoxel> occupied_in(const VoxelMap& map, const VoxelBox& box,
                                    double occupied_log_odds);

/// Returns the number of observed voxels.
std::size_t known_count(const VoxelMap& map);

}  // namespace mapperd::map
