// Poses of a block of particles in the cells of a padded grid.
#pragma once

#include <cmath>
#include <cstddef>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/grid.hpp"

namespace mapperd::localization {

struct BlockPoses {
  double u[kBlock];
  double v[kBlock];
  double cosine[kBlock];
  double sine[kBlock];
};

// From the map frame to cells of the grid with its border.
struct Lattice {
  double origin_x, origin_y;
  double cosine, sine;  // of the grid, over the resolution
  double yaw;
  double last_u, last_v;  // the border
};

inline Lattice lattice_of(const GridFrame& frame) {
  return {frame.origin.x,
          frame.origin.y,
          std::cos(frame.origin.yaw) / frame.resolution_m,
          std::sin(frame.origin.yaw) / frame.resolution_m,
          frame.origin.yaw,
          static_cast<double>(frame.columns) + 1.0,
          static_cast<double>(frame.rows) + 1.0};
}

// The poses of `count` particles; the rest of the block is filled up.
void pose_block(const double* x, const double* y, const double* yaw, std::size_t count,
                const Lattice& lattice, BlockPoses& out);

}  // namespace mapperd::localization
