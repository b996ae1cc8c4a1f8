/// \file
/// \brief Merging of maps, and conversion to another rule.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <vector>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Adds the evidence of `others` to `map`, as if their pings had been independent observations of
/// voxels that all maps hold at 0 in the beginning:
///   L = clamp(L_map + L_1 + L_2 + ..., L_min, L_max),  n = min(n_map + n_1 + n_2 + ..., settled).
/// All log-odds of a voxel are added before the one clamp, so that neither the order of the others
/// nor which of the maps takes them changes the result; merging them one call after the other
/// clamps in between, and then the order can matter where a sum leaves the clamps. What a map had
/// lost at its own clamps stays lost. Voxels that only one map observed keep their state.
///
/// \throws std::invalid_argument, with nothing changed, unless all maps have the resolution, clamps
/// and settled count of `map`, and when `map` is among the others.
void merge(VoxelMap& map, const std::vector<const VoxelMap*>& others);

/// Returns the same content under another rule: clamps the log-odds and limits the counts.
VoxelMap with_rule(const VoxelMap& map, const IwloParams& params);

}  // namespace mapperd::map
