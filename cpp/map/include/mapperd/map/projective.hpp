// The projective integrator: each voxel is projected into the ping once.
#pragma once

#include <cstddef>

#include "mapperd/map/fan.hpp"
#include "mapperd/common/vec.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

struct PingStats {
  std::size_t occupied = 0;
  std::size_t free = 0;
  std::size_t blocks_visited = 0;
  std::size_t blocks_created = 0;
};

// Throws std::invalid_argument for a bad ping, pose or motion, std::out_of_range for a pose so far
// away that the ping would leave the map's reach. The map is unchanged then. A ping without motion
// gives the same bits as before there was motion.
PingStats integrate_projective(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
                               const FanSettings& settings, const PingMotion& motion = {});

// Throws as above; shared by the integrators.
void check_reach(const VoxelMap& map, const Transform& map_T_sonar, double max_range_m,
                 const PingMotion& motion);

// Where the sonar was at transmission: a block, and the pose from its corner. Far from the map's
// origin no precision is lost.
struct BlockPose {
  BlockKey block;
  Transform block_T_sonar;
};
BlockPose at_transmission(const Transform& map_T_sonar, const PingMotion& motion, double block_m);

}  // namespace mapperd::map
