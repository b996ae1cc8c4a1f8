/// \file
/// \brief The preview of a ping: patches of surface that coarse rays hit, the coarse picture of
/// their echoes, and how much two such pictures differ.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/scatter.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// What coarse rays hit; borrowed, not copied. Each ray stands for a cell of sines s = -y, w = z.
struct CoarseRays {
  std::size_t count;
  const std::int32_t* face;      ///< (count,); negative: nothing
  const std::int32_t* group;     ///< (count,): index of the face's frame
  const float* range_m;          ///< (count,)
  const double* direction;       ///< unit vectors, sonar frame, (count, 3)
  const double* solid_angle_sr;  ///< (count,)
  double s_step, w_step;         ///< edges of each cell
  Transform map_T_sonar;
};

/// Where coarse rays hit a surface, one number or vector for each hit.
struct CoarsePatches {
  std::int64_t* ray;
  double* point_m;        ///< map frame, (count, 3)
  double* normal;         ///< unit, map frame, (count, 3)
  double* cos_incidence;  ///< at least 0
  double* area_m2;        ///< of the cell's part of the surface
  double* extent_m;       ///< in range
  double* turn;  ///< variances of the normal by curvature: their sum, their product, and that
                 ///< along the ray's projection on the tangent plane, (count, 3)
};

/// Computes the patches of surface that rays hit.
///
/// \param reach_m farther hits are left out
/// \param map_T_group of each frame
/// \param[out] to has room for all rays
/// \return the number of patches
std::size_t coarse_patches(const Faces& faces, const CoarseRays& rays, double reach_m,
                           const Transform* map_T_group, const CoarsePatches& to);

/// Patches that send echoes back; borrowed, not copied.
struct RangePatches {
  std::size_t count;
  const std::int64_t* column;  ///< (count,), within the picture
  const double* range_m;       ///< of their middles, (count,)
  const double* extent_m;      ///< in range, (count,)
  const double* power;         ///< (count,)
};

/// Adds up the patches' power per length of range: each spreads evenly over the rows it covers, and
/// over at least one. The picture is (rows, columns).
void spread_over_rows(const RangePatches& patches, double row_m, std::size_t rows,
                      std::size_t columns, double* picture);

/// Numbers no less than 0 and no larger than a limit, times a factor; NaN counts as 0.
void limited(const double* from, std::size_t count, double limit, double factor, float* to);

/// Two pictures of expected amplitudes of full scale, (rows, columns), and how they are compared.
struct PicturePair {
  const float* first;
  const float* second;
  std::size_t rows;
  std::size_t columns;
  float gamma;          ///< a pixel is amplitude^gamma times the largest pixel
  double row_cells;     ///< displacement in rows that does not count
  double column_cells;  ///< the same in columns
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
