/// \file
/// \brief Integrates pings by the arc rule (arc_model.hpp).
///
/// Silence before the first return of a beam is one constant free step, where a surface would be
/// heard above the noise. Behind the first return, where shadows lie, nothing becomes free.
///
/// The steps of a ping depend on the map before the ping alone, and sums are whole numbers: the map
/// does not depend on the number of threads.
#pragma once

#include <cstdint>
#include <vector>

#include "mapperd/map/arc_model.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Levels of a ping: amplitudes relative to that of a surface on the beam's axis.
struct ArcImage {
  PingImage image;               ///< `intensity` holds the relative levels
  const float* noise = nullptr;  ///< [row] median of the noise, relative likewise, above 0
};

/// What the echoes of a ping changed in a map.
struct ArcChanges {
  std::vector<std::uint32_t> counts;  ///< number of the steps by cube of the fan's blocks
  std::vector<std::int16_t> steps;    ///< of each voxel on an arc with an echo, in the map's units
};

/// \param changes receives what the echoes changed; may be null.
/// \throws as integrate_evidence_grid(), and std::invalid_argument for noise that is no positive
/// number.
PingStats integrate_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                        const Transform& map_T_sonar, const PingParams& settings,
                        const PingMotion& motion = {}, ArcChanges* changes = nullptr);

/// Integrates the echoes of a ping again that the map holds already: by what all other pings hold
/// of its voxels, the later ones too. One step of expectation propagation (T. P. Minka, Expectation
/// Propagation for approximate Bayesian inference, 2001). Its silence stays as it is.
/// \param changes of this ping, by the same arguments; receives the new ones.
/// \throws as integrate_arc(), and std::invalid_argument for changes of another ping. The map is
/// unchanged then.
PingStats refine_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                     const Transform& map_T_sonar, const PingParams& settings,
                     const PingMotion& motion, ArcChanges& changes);

}  // namespace mapperd::map
