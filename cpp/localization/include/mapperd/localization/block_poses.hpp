/// \file
/// \brief Poses of a block of particles in the cells of a padded grid.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cmath>
#include <cstddef>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/grid.hpp"

namespace mapperd::localization {

/// Poses of a block of particles, one array per quantity.
struct BlockPoses {
  double u[kBlock];
  double v[kBlock];
  double cosine[kBlock];
  double sine[kBlock];
};

/// Transform from the map frame to cells of the padded grid.
struct GridTransform {
  double origin_x, origin_y;
  double cosine, sine;  ///< of the grid, over the resolution
  double yaw;
  double last_u, last_v;  ///< the border
};

inline GridTransform grid_transform_of(const GridFrame& frame) {
  return {frame.origin.x,
          frame.origin.y,
          std::cos(frame.origin.yaw) / frame.resolution_m,
          std::sin(frame.origin.yaw) / frame.resolution_m,
          frame.origin.yaw,
          static_cast<double>(frame.columns) + 1.0,
          static_cast<double>(frame.rows) + 1.0};
}

/// Computes the poses of `count` particles, and fills the rest of the block.
void pose_block(const double* x, const double* y, const double* yaw, std::size_t count,
                const GridTransform& to_grid, BlockPoses& out);

}  // namespace mapperd::localization
