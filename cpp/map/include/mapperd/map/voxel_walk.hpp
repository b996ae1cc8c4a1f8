/// \file
/// \brief The voxels that a ray runs through, in order (Amanatides and Woo, "A Fast Voxel Traversal
/// Algorithm for Ray Tracing", 1987).
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Longest ray, in voxels, against typing errors.
inline constexpr double kMaxRayVoxels = 1e6;

/// Returns the unit vector of a vector that is finite and not 0. Scaled first, so that neither
/// large nor small vectors leave the range of a double.
inline Vec3 unit_vector(const Vec3& v) {
  const double largest = std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
  const Vec3 scaled{v.x / largest, v.y / largest, v.z / largest};
  return (1.0 / norm(scaled)) * scaled;
}

/// Each crossing is computed from the voxel's index, so that no error adds up on the way. A ray
/// that leaves a voxel exactly through an edge or a corner continues diagonally and skips voxels
/// that it only touches.
class VoxelWalk {
 public:
  /// `direction` of unit length; `start` is the voxel that holds `origin_m`.
  VoxelWalk(double resolution_m, const VoxelIndex& start, const Vec3& origin_m,
            const Vec3& direction)
      : resolution_(resolution_m),
        index_{start.x, start.y, start.z},
        origin_{origin_m.x, origin_m.y, origin_m.z},
        direction_{direction.x, direction.y, direction.z} {
    for (std::size_t axis = 0; axis < 3; ++axis) exit_[axis] = crossing(axis);
  }

  VoxelIndex voxel() const { return {index_[0], index_[1], index_[2]}; }

  /// Distance along the ray, m, at which it enters the voxel; 0 in the first voxel.
  double entry_m() const { return entry_; }

  /// Moves to the next voxel.
  void advance() {
    const double nearest = std::min({exit_[0], exit_[1], exit_[2]});
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (exit_[axis] > nearest) continue;
      index_[axis] += direction_[axis] > 0 ? 1 : -1;
      exit_[axis] = crossing(axis);
    }
    entry_ = std::max(entry_, nearest);
  }

 private:
  double crossing(std::size_t axis) const {
    const double slope = direction_[axis];
    if (slope == 0) return std::numeric_limits<double>::infinity();
    const double face = static_cast<double>(index_[axis] + (slope > 0 ? 1 : 0)) * resolution_;
    return (face - origin_[axis]) / slope;
  }

  double resolution_;
  std::array<std::int64_t, 3> index_;
  std::array<double, 3> origin_;
  std::array<double, 3> direction_;
  std::array<double, 3> exit_{};
  double entry_ = 0.0;
};

}  // namespace mapperd::map
