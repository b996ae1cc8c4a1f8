/// \file
/// \brief The evidence grid's integrator: coarse to fine over class masks, one look-up per voxel.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// \throws std::invalid_argument for a bad ping, pose or motion, std::out_of_range for a pose so
/// far away that the ping would leave the map's reach. The map is unchanged then.
PingStats integrate_evidence_grid(VoxelMap& map, const PingImage& image,
                                  const Transform& map_T_sonar, const PingParams& settings,
                                  const PingMotion& motion = {});

}  // namespace mapperd::map
