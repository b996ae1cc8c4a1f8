/// \file
/// \brief Edges of a triangle mesh at which its outline may lie.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace mapperd::acoustics {

/// An edge of one or two faces; edges of more faces count as borders.
struct MeshEdge {
  float end_m[2][3];  ///< mesh frame
  float inner_m[3];   ///< the third corner of the first face
  float plane[2][4];  ///< of the faces: normal, offset; equal ones at a border
  bool border;        ///< it has one face
  bool crease;        ///< the faces' normals or surfaces differ much
  bool round;         ///< the faces are part of a curved surface
};

/// Edges that lie together, to be passed over together.
struct EdgeBlock {
  std::size_t first, last;
  float centre_m[3], radius_m;  ///< of a ball about them
  float axis[3], cosine;        ///< of a cone that holds their faces' normals
  bool smooth;                  ///< none is a border or a crease
};

/// Edges of a mesh, block after block.
struct MeshEdges {
  std::vector<MeshEdge> edges;
  std::vector<EdgeBlock> blocks;
};

/// Returns the edges of `count` triangles. Corners at the same place are one corner. Edges between
/// faces of one plane and surface are left out: no outline lies there.
///
/// \param corners_m (count, 3, 3)
/// \param normals unit vectors, (count, 3)
/// \param surface index of the surface that each face belongs to, (count,)
MeshEdges mesh_edges(const float* corners_m, const float* normals, const std::int32_t* surface,
                     std::size_t count);

}  // namespace mapperd::acoustics
