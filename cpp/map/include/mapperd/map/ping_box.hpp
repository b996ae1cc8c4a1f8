// Which blocks a ping may change, told from its geometry alone: for whoever sorts pings by place
// before any of them is integrated.
#pragma once

#include <optional>

#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

// A box that holds every block that the ping can change, by either integrator; nothing for a ping
// that says nothing. Throws as the integrators do, for the same pings.
std::optional<BlockBox> blocks_of_ping(const VoxelMap& map, const PingImage& image,
                                       const Transform& map_T_sonar, const PingParams& settings,
                                       const PingMotion& motion = {});

}  // namespace mapperd::map
