/// \file
/// \brief One ping as input of the map: image, geometry, parameters and pose.
///
/// Sonar frame: x along the centre beam, y to port, z up; positive bearing is to starboard, so a
/// point at range r, bearing b, elevation e is (r cos e cos b, -r cos e sin b, r sin e).
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping_motion.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// How occupied and free evidence of one ping combine in a voxel.
enum class Aggregation {
  kOccupiedFirst,  ///< occupied evidence beats free evidence inside one ping
  kMean,           ///< both kinds by their shares, averaged as in the reference implementation
};

/// A view of a ping image: row-major, row 0 nearest, column 0 the most negative bearing.
struct PingImage {
  const float* intensity = nullptr;
  std::size_t rows = 0;
  std::size_t beams = 0;
  const double* bearings_rad = nullptr;  ///< strictly increasing, within +-90 degrees
  double range_resolution_m = 0.0;

  float at(std::size_t row, std::size_t beam) const { return intensity[row * beams + beam]; }
  double max_range_m() const { return static_cast<double>(rows) * range_resolution_m; }
};

/// How a ping is integrated.
struct PingParams {
  double vertical_aperture_rad = 0.349065850398866;  ///< 20 degrees
  double min_range_m = 0.5;                          ///< nearer samples are ignored, m
  bool carve_no_return = false;                      ///< beams without a return mark free space
  Aggregation aggregation = Aggregation::kOccupiedFirst;
  double detail = 1.0;  ///< of the evidence grid; its pitch shrinks as this grows
  int threads = 1;      ///< the map does not depend on it
};

/// What a ping changed: numbers of voxels and blocks.
struct PingStats {
  std::size_t occupied = 0;  ///< voxels with occupied evidence
  std::size_t free = 0;      ///< voxels with free evidence
  std::size_t blocks_visited = 0;
  std::size_t blocks_created = 0;
};

/// \throws std::invalid_argument, naming the argument, for a ping that cannot be projected.
void check_ping(const PingImage& image, const PingParams& settings);

/// \throws std::invalid_argument for a bad pose or motion, std::out_of_range for a pose so far away
/// that the ping would leave the map's reach.
void check_reach(const VoxelMap& map, const Transform& map_T_sonar, double max_range_m,
                 const PingMotion& motion);

/// Returns the sines of the beams' edges, beams + 1 of them: half way between neighbours, because
/// the sonar spaces its beams uniformly in sine; the outermost are extrapolated, within +-1.
std::vector<double> beam_edge_sines(const double* bearings_rad, std::size_t beams);

/// Returns the point of the sonar frame, m, at a range, bearing and elevation.
Vec3 fan_point(double range_m, double bearing_rad, double elevation_rad);

/// Pose of the sonar at transmission, relative to the corner of a block: no precision is lost far
/// from the map's origin.
struct BlockPose {
  BlockKey block;
  Transform block_T_sonar;
};
BlockPose at_transmission(const Transform& map_T_sonar, const PingMotion& motion, double block_m);

}  // namespace mapperd::map
