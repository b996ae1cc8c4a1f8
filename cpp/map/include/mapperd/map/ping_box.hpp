/// \file
/// \brief Bounding box of the blocks that a ping may change, from its geometry alone: for sorting
/// pings by place before any of them is integrated.
///
/// \par Threads
/// Reads only the map's resolution, rule and limit: needs no lock unless a thread changes the
/// rule's intensity threshold or the limit.
#pragma once

#include <optional>

#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Returns a box of all blocks that either integrator can change, or nullopt for a ping without
/// evidence. Errors are those of the integrators.
std::optional<BlockBox> blocks_of_ping(const VoxelMap& map, const PingImage& image,
                                       const Transform& map_T_sonar, const PingParams& settings,
                                       const PingMotion& motion = {});

}  // namespace mapperd::map
