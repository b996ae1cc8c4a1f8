/// \file
/// \brief Integrates pings by the arc rule (arc_model.hpp).
///
/// Silence before the first return of a beam is one constant free step, where a surface would be
/// heard above the noise. Behind the first return, where shadows lie, nothing becomes free.
///
/// The steps of a ping depend on the map before the ping alone, and sums are whole numbers: the map
/// does not depend on the number of threads.
#pragma once

#include "mapperd/map/arc_model.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Levels of a ping: amplitudes relative to that of a surface on the beam's axis.
struct ArcImage {
  PingImage image;               ///< `intensity` holds the relative levels
  const float* noise = nullptr;  ///< [row] median of the noise, relative likewise, above 0
};

/// \throws as integrate_evidence_grid(), and std::invalid_argument for noise that is no positive
/// number.
PingStats integrate_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                        const Transform& map_T_sonar, const PingParams& settings,
                        const PingMotion& motion = {});

}  // namespace mapperd::map
