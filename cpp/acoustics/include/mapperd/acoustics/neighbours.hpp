/// \file
/// \brief Edges and extents of ray hits, from the hits of neighbouring rays. Rays are ordered by
/// column, in each from bottom to top.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace mapperd::acoustics {

/// Hits of rays; a negative face means no hit.
struct TracedRays {
  std::size_t count;
  const float* direction;  ///< (count, 3), map frame
  const float* range_m;
  const std::int32_t* face;
  const std::int32_t* group;   ///< whose frame the face is in
  std::int32_t standing;       ///< the group whose frame is the map, negative for none
  const std::int32_t* column;  ///< of the fan
};

/// Tolerances within which two neighbouring hits lie on the same surface.
struct SurfaceCriteria {
  float max_slope;   ///< maximum slope from one's plane to the other
  float min_step_m;  ///< deviation that is always allowed
  float min_cosine;  ///< between the normals on a round surface
};

/// Returns the indices of rays whose upper neighbour in the column hit another surface. `normals`
/// (F, 3) and `smooth` (F,) belong to the faces; `smooth` is not negative for round ones. Normals
/// of moving objects are in their own frames: their rays are compared by group alone.
std::vector<std::int64_t> edges(const TracedRays& rays, const float* normals,
                                const std::int32_t* smooth, const SurfaceCriteria& same);

/// Returns the ranges between which each hit's plane is followed, (count, 2): those of neighbours
/// in this and the adjacent columns on the same surface, widened by the face's size. `up` (count,)
/// is each ray's sine of elevation; `surface` and `size_m` belong to the faces.
void spans(const TracedRays& rays, const float* up, const std::int32_t* surface,
           const float* size_m, float* span_m);

}  // namespace mapperd::acoustics
