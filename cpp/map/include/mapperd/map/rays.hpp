/// \file
/// \brief Sampled sub-rays, as in sonar_3d_reconstruction, the mapper that this project grew from.
///
/// The baseline that the evidence grid is measured against, with that mapper's steps and
/// quirks:
/// - of a wide image only every (beams / 256)-th beam is used;
/// - a row's range is its near edge;
/// - free space is sampled in rows 0, 10, 20, ... and about every 4 voxels of elevation, from the
///   sonar on (min_range counts for returns alone); returns about every 1.5 voxels of elevation,
///   within 50 rows from the first;
/// - the shadow test compares a horizontal distance with slant ranges, within a tolerance that at
///   angular_cone_width 0.5 is the mean beam spacing: with equal angles no neighbour is nearer,
///   with the sonar's own table those around the centre beam are;
/// - of a voxel's returns in a ping the first one's intensity counts; occupied beats free.
/// Not kept: the equal-angle bearings (the ping's own table is used), and the sample count as a
/// weight, which only one of its two back ends had.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// How a ping is integrated by sampled rays.
struct RaysParams {
  double vertical_aperture_rad = 0.349065850398866;  ///< 20 degrees
  double min_range_m = 0.5;                          ///< nearer samples are ignored, m
  double angular_cone_width = 0.5;                   ///< a factor of the beam spacing, not an angle
};

/// Integrates one ping. Errors are those of integrate_evidence_grid().
PingStats integrate_rays(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
                         const RaysParams& settings, const PingMotion& motion = {});

}  // namespace mapperd::map
