/// \file
/// \brief The preview of a ping: normals and curvatures where coarse rays hit, the coarse picture
/// of their echoes, and how much two such pictures differ.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/scatter.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// What coarse rays hit; borrowed, not copied.
struct CoarseRays {
  std::size_t count;
  const std::int32_t* face;   ///< (count,); negative: nothing
  const std::int32_t* group;  ///< (count,): index of the face's frame
  const float* range_m;       ///< (count,)
  Vec3 origin_m;              ///< of all rays, map frame
  const double* direction;    ///< unit vectors, map frame, (count, 3)
};

/// Normals and curvatures of the surfaces that rays hit.
///
/// \param map_T_group of each frame
/// \param[out] normal unit, map frame, (count, 3); 0 for a ray that hit nothing
/// \param[out] turn (count, 3): sum of the squared principal curvatures, 1/m²; square of their
///     product, 1/m⁴; square of how fast the normal turns along the ray's projection on the tangent
///     plane, 1/m². 0 for flat faces.
void surface_normals(const Faces& faces, const CoarseRays& rays, const Transform* map_T_group,
                     double* normal, double* turn);

/// Patches that send echoes back; borrowed, not copied.
struct Patches {
  std::size_t count;
  const std::int64_t* column;  ///< (count,), within the picture
  const double* range_m;       ///< of their middles, (count,)
  const double* extent_m;      ///< in range, (count,)
  const double* power;         ///< (count,)
};

/// Adds up the patches' power per length of range: each spreads evenly over the rows it covers, and
/// over at least one. The picture is (rows, columns).
void spread_over_rows(const Patches& patches, double row_m, std::size_t rows, std::size_t columns,
                      double* picture);

/// Two pictures of expected amplitudes of full scale, (rows, columns), and how they are compared.
struct PicturePair {
  const float* first;
  const float* second;
  std::size_t rows;
  std::size_t columns;
  float gamma;          ///< a pixel is amplitude^gamma times the largest pixel
  double row_cells;     ///< displacement that does not count
  double column_cells;  ///< the same along the rows
};

/// Difference in dB that at most `exceeding` pixels exceed. Pixels that differ by less than a step
/// of the quantiser do not differ.
double pixel_change_db(const PicturePair& pictures, float largest_pixel, std::size_t exceeding);

/// Mean pixel of speckle over its rms amplitude from 0 to `limit`, `entries` values and a 0.
struct DarkPixels {
  const float* mean_pixel;
  std::size_t entries;
  float limit;
};

/// Largest difference in dB between the means of what is dark in both pictures, over bands of
/// range.
double dark_change_db(const PicturePair& pictures, const DarkPixels& dark);

}  // namespace mapperd::acoustics
