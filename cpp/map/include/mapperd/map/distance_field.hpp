/// \file
/// \brief The truncated Euclidean distance field of the occupied voxels.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <vector>

#include "mapperd/map/voxel_box.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Returns for each voxel of the box, z fastest, the distance in metres from its centre to the
/// centre of the nearest occupied voxel, in the box or not; max_distance_m where that is further
/// away.
///
/// Exact: squared distances are whole numbers of voxels, and the lower envelope of parabolas along
/// each axis in turn (Felzenszwalb and Huttenlocher 2012; the integer form is Meijster's, 2000) is
/// computed in whole numbers. A box one voxel thick gives a slice of the 3D field.
///
/// \throws std::invalid_argument for a distance that is not positive, or when the box with
/// max_distance_m around it holds more than kMaxBoxVoxels.
std::vector<float> distance_field(const VoxelMap& map, const VoxelBox& box, double max_distance_m,
                                  double occupied_log_odds);

}  // namespace mapperd::map
