/// \file
/// \brief The blocks of the map that a ping's fan may meet, and how the sonar sees each of them.
///
/// Coordinates are relative to the sonar's block: far from the map's origin no precision is lost.
///
/// \par Threads
/// Const members may run concurrently.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/polar_grid.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Blocks are worked on in cubes of so many along an edge: what one thread takes at once.
inline constexpr int kCubeBlocks = 4;

/// A cube of blocks.
struct BlockCube {
  BlockKey first;  ///< relative to the sonar's block
  int blocks;      ///< along an edge
};

/// A block as the sonar sees it. Lengths in voxels, unless noted.
struct BlockView {
  Vec3 centre;               ///< the map's axes, from the sonar, in metres
  Vec3 seen;                 ///< sonar frame
  std::array<Vec3, 3> step;  ///< a voxel's step along the map's x, y, z in the sonar frame
  bool is_linear;
};

/// The blocks that a ping's fan reaches, and their poses relative to the sonar.
class FanBlocks {
 public:
  FanBlocks(const VoxelMap& map, const PolarGrid& grid, const Transform& map_T_sonar,
            const PingMotion& motion)
      : map_(map),
        grid_(grid),
        edge_m_(map.resolution_m()),
        block_m_(edge_m_ * kBlockEdge),
        start_(at_transmission(map_T_sonar, motion, block_m_)),
        low_side_{low_normal(grid.low_sine())},
        high_side_{-1.0 * low_normal(grid.high_sine())} {
    if (motion.any()) view_.emplace(motion, start_.block_T_sonar);
  }

  /// Cubes that share space with the fan.
  std::vector<BlockCube> cubes() const;
  /// Brings all blocks that may be changed into memory: the ping counts wholly or not.
  void fetch(VoxelMap& map, const std::vector<BlockCube>& cubes) const;

  BlockKey absolute(const BlockKey& at) const {
    const BlockKey& origin = start_.block;
    return {origin.x + at.x, origin.y + at.y, origin.z + at.z};
  }
  Vec3 to_sonar(const Vec3& v) const { return start_.block_T_sonar.rotate_back(v); }

  BlockView view_of(const BlockCube& block) const;
  /// Classes of evidence that the block may hold.
  std::uint8_t classes_of(const BlockView& view) const;
  /// Places of a cell's voxels in the sonar frame, m, each on its own.
  void places_of(const BlockView& view, int cell, CellPoints& points) const;

  /// Visits all cubes of `smallest` blocks in a cube that may be seen.
  template <typename Found>
  void visit(const BlockCube& cube, const Found& found, int smallest) const {
    if (!may_be_seen(cube)) return;
    if (cube.blocks == smallest) return found(cube);
    const int half = cube.blocks / 2;
    const BlockKey& at = cube.first;
    for (int child = 0; child < 8; ++child) {
      visit({{at.x + half * (child & 1), at.y + half * (child >> 1 & 1),
              at.z + half * (child >> 2 & 1)},
             half},
            found, smallest);
    }
  }

 private:
  // Of the plane through the sonar's vertical axis and a bearing; points to larger bearings.
  static Vec3 low_normal(double sine) {
    return {-sine, -std::sqrt(std::max(0.0, 1.0 - sine * sine)), 0.0};
  }

  Vec3 centre_of(const BlockCube& cube) const;
  bool may_be_seen(const BlockCube& cube) const;

  const VoxelMap& map_;
  const PolarGrid& grid_;
  double edge_m_;
  double block_m_;
  BlockPose start_;
  Vec3 low_side_;  // positive inside
  Vec3 high_side_;
  std::optional<MovingView> view_;
};

}  // namespace mapperd::map
