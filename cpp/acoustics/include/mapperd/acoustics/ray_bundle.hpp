/// \file
/// \brief What rays that share an origin meet first: triangles are projected onto the rays.
///
/// Faster than a search for each ray, as long as rays are not much fewer than triangles in reach.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// Triangles that lie together, to be passed over together. The last pack is padded with triangles
/// without area.
struct TrianglePack {
  static constexpr std::size_t kSize = 32;
  float corner_m[3][3][kSize];   ///< by corner, by axis, mesh frame
  std::int32_t index[kSize];     ///< of each among those given
  float middle_m[3], half_m[3];  ///< of a box about them
};

/// Limit of the corners' coordinates: the squares of areas must not overflow.
constexpr float kMaxCornerM = 1e9F;

/// \param corners_m (count, 3, 3), each less than `kMaxCornerM`
std::vector<TrianglePack> pack_triangles(const float* corners_m, std::size_t count);

/// Rays of one origin, mesh frame.
struct RayBundle {
  std::size_t count;
  double origin_m[3];
  const float* direction;  ///< unit vectors, (count, 3)
  const float* near_m;     ///< hits at or below this range are ignored, (count,); null: `kNearM`
};

/// Default minimum range: hides the face that a sonar lies in, if its corners are within 100 m.
/// Those of larger faces are rounded by more.
constexpr float kNearM = 1e-4F;

/// Finds the first triangle on each ray, from either side; of several at one range, the first of
/// those given. Triangles that share an edge leave no gap there. A ray's result does not depend on
/// the other rays or on the number of threads.
///
/// \param first_face added to the triangles' indices
/// \param range_m (count,), in: maximum range; out: range of the hit, unchanged for a miss
/// \param face (count,), of the hit, unchanged for a miss
void cast_bundle(const std::vector<TrianglePack>& mesh, const RayBundle& rays,
                 std::int32_t first_face, unsigned threads, float* range_m, std::int32_t* face);

/// Multiplies rows (count, 3) by a matrix (3, 3), row by row; `to` does not overlap `rows`.
void multiply_rows(const float* rows, std::size_t count, const std::array<float, 9>& matrix,
                   float* to);

/// The sea's surface over a sonar.
struct SeaSurface {
  double above_m;            ///< over the rays' origin; 0 or less: no ray meets it
  std::int32_t face, group;  ///< entered where a ray meets it
};

/// Enters where rays meet the sea from below before anything else. `near_m` of the rays may be
/// null: no limit.
///
/// \param range_m (count,), in: range of the hit so far; out: nearer ones replaced
void meet_sea(const RayBundle& rays, const SeaSurface& sea, float* range_m, std::int32_t* face,
              std::int32_t* group);

/// Indices of the rays that pass through a ball within `reach_m`.
///
/// \param start_m (count, 3)
/// \param direction unit vectors, (count, 3)
std::vector<std::int64_t> rays_near_ball(std::size_t count, const double* start_m,
                                         const float* direction, double reach_m,
                                         const double* middle_m, double radius_m);

/// Hits of the rays of one origin.
struct SeenRays {
  std::size_t count;
  const float* direction;      ///< unit vectors, sonar frame, (count, 3)
  const float* map_direction;  ///< the same in the map frame, (count, 3)
  const std::int32_t* face;    ///< (count,); negative: nothing
  const float* range_m;        ///< (count,)
  Vec3 origin_m;               ///< map frame
};

/// Points of hits within a range and within sines of bearing and elevation, map frame, three
/// numbers each.
std::vector<double> visible_points(const SeenRays& rays, double range_m, double bearing_sine,
                                   double elevation_sine);

/// Directions of a fan, each the middle of a cell of sines s = -y, w = z; sonar x ahead.
struct FanDirections {
  std::size_t count;
  const float* direction;  ///< unit vectors, (count, 3)
  const float* cell;       ///< (count, 4): s from, s to, w from, w to
};

/// A part of a plane that rays of a fan may pass through.
struct MirrorWindow {
  Transform map_T_fan;  ///< the rotation may reflect
  Vec3 normal;          ///< of the plane, map frame, to the side that rays go to
  double height_m;      ///< of the plane over the fan's origin, along the normal
  Vec3 low_m, high_m;   ///< box that holds the window, map frame
  double margin_m;      ///< by which the box is widened
  double reach_m;       ///< maximum range to the plane
};

/// Indices of the cells of which a direction may pass through a window.
std::vector<std::int64_t> cells_through_window(const FanDirections& fan,
                                               const MirrorWindow& window);

}  // namespace mapperd::acoustics
