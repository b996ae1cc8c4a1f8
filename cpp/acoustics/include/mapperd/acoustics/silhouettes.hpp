/// \file
/// \brief Refinement of a fan of rays along the outlines of what it meets.
///
/// A ray stands for a cell of directions. Where an outline crosses a cell, the cell is cut along it
/// into parts that each show one surface, and each part gets a ray: an object of any width shows,
/// with the solid angle that it has. A part between two outlines leans as they do, so that all of
/// it lies on what it shows. Directions are counted in s (starboard) and w (up).
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/acoustics/mesh_edges.hpp"
#include "mapperd/acoustics/sound_layers.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// Edges of a mesh as seen from the sonar.
struct SeenMesh {
  const MeshEdges* mesh;
  std::array<double, 9> rotation;  ///< sonar from mesh, row by row
  Vec3 origin_m;                   ///< of the mesh's frame, in the sonar's
  Vec3 sonar_m;                    ///< in the mesh's frame
};

/// A sonar in layers that bend its rays.
struct RefractionView {
  SoundLayers layers;
  Vec3 up;          ///< in the sonar's frame
  double height_m;  ///< of the sonar over the sea's surface
};

/// Grid of a fan's cells.
struct FanGrid {
  std::size_t columns, rows;
  double first_s, s_pitch;   ///< where column 0 begins; width of a column
  const double* row_edges;   ///< sines of elevation, ascending, (rows + 1,)
  const std::int32_t* rays;  ///< ray of each cell: each ray once and in order; -1 where a cell has
                             ///< none, (columns, rows)
};

/// Rays, cell after cell as in the fan that they refine.
struct RefinedRays {
  std::vector<float> direction;      ///< sonar frame, (count, 3)
  std::vector<float> cell;           ///< s from, s to, w from, w to, (count, 4)
  std::vector<float> lean;           ///< see `RayHits::lean`, (count, 2)
  std::vector<std::int32_t> column;  ///< (count,)
  std::vector<std::int32_t> from;    ///< ray of the fan that it is, or -1 for a new one, (count,)
};

/// What each ray of the fan met; a range is infinite where it met nothing.
struct FanHits {
  std::size_t count;
  const float* range_m;
  const float* direction;  ///< sonar frame, (count, 3)
  const float* cell;       ///< (count, 4)
};

/// Refines a fan.
///
/// \param pairs rays whose upper neighbour met another surface, ascending: where no outline is
///     between the two, as between a pile and the floor that it stands in, rays are laid between
///     them. Of many pairs, those farthest apart in range are taken.
/// \param reach_m maximum range of an outline
/// \param view layers that bend the rays: edges are seen where their rays leave, to the first order
///     of the bending
RefinedRays refined_rays(const FanGrid& grid, const FanHits& hits,
                         const std::vector<SeenMesh>& meshes,
                         const std::vector<std::int64_t>& pairs, double reach_m,
                         const RefractionView& view);

}  // namespace mapperd::acoustics
