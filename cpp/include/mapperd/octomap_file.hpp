// OctoMap's binary tree file (.bt), written from the map without a second tree in between.
#pragma once

#include <string>

#include "mapperd/voxel_map.hpp"

namespace mapperd {

// Occupied above `occupied_log_odds`, free below `free_log_odds`, anything else unknown; equal
// children are pruned as OctoMap itself does before it writes.
// Throws std::out_of_range, naming the voxel, where OctoMap's 16-bit keys do not reach.
std::string octomap_bt(const VoxelMap& map, double occupied_log_odds, double free_log_odds);

}  // namespace mapperd
