/// \file
/// \brief Reverberation, noise and clouds in the grid of cells, in addition to echoes of surfaces.
/// Fields are complex, (rows, columns), real and imaginary parts in turn.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::acoustics {

/// Mean powers of cells: (row_rms[row] column_rms[column])² + extra_power[row, column].
struct CellLevels {
  const float* row_rms;
  const float* column_rms;
  const float* extra_power = nullptr;  ///< (rows, extra_columns), or null for 0
  std::size_t extra_columns = 0;       ///< as many as the field has, or 1 for the whole row
};

/// Adds an independent complex Gaussian number to each cell.
void add_gaussian(float* field, std::size_t rows, std::size_t columns, const CellLevels& levels,
                  std::uint64_t key, unsigned threads);

/// Evenly spaced columns of a coarse grid, on the columns of the field.
struct CoarseColumns {
  std::size_t count;
  double first;  ///< column of the first
  double step;   ///< columns between them
};

/// The same, with mean powers on coarse columns, (rows, coarse.count): linear between them, and
/// constant beyond the ends.
void add_gaussian_power(float* field, std::size_t rows, std::size_t columns, const float* power,
                        const CoarseColumns& coarse, std::uint64_t key, unsigned threads);

/// Mean power of blocks of `width` columns, (rows, blocks); the last may be narrower. Cells are
/// complex (parts 2) or powers (parts 1).
void block_powers(const float* cells, std::size_t parts, std::size_t rows, std::size_t columns,
                  std::size_t width, float* out, unsigned threads);

/// Sum of a part of all earlier rows, that fades from row to row: out[r + 1] = energy power[r] +
/// kept out[r], (rows, columns).
void decaying_sum(const float* power, std::size_t rows, std::size_t columns, double energy,
                  double kept, float* out);
void decaying_sum(const double* power, std::size_t rows, std::size_t columns, double energy,
                  double kept, double* out);

/// The product of powers (rows, columns) with weights (columns, out_columns), (rows, out_columns).
/// Zeros at the ends of the weights' rows cost nothing.
void spread_columns(const float* power, std::size_t rows, std::size_t columns, const float* weights,
                    std::size_t out_columns, float* out, unsigned threads);
void spread_columns(const double* power, std::size_t rows, std::size_t columns,
                    const double* weights, std::size_t out_columns, double* out, unsigned threads);

/// Ranges between which rays of one origin are inside a box; equal where they miss it.
///
/// \param low, high corners of the box, from the origin, (3,)
/// \param direction unit vectors, (count, 3)
/// \param reach_m where the rays end, (count,)
/// \param enter, leave at least 0, (count,)
void box_crossing(const double* low, const double* high, std::size_t count, const float* direction,
                  const double* reach_m, double* enter, double* leave);

/// Rays through a cloud, one array per quantity.
struct CloudRays {
  std::size_t count;
  const double* enter_row;  ///< where the ray enters, at least 0; rows and parts of them
  const double* leave_row;  ///< not before
  const std::int32_t* column;
  const double* weight;  ///< of the ray
};

/// How a cloud's echo falls.
struct CloudFade {
  const double* row;     ///< (rows,)
  const double* column;  ///< (columns,); the product counts as at most 1
  const double* level;   ///< factor to power, (rows,)
};

/// Adds to the powers (rows, columns) the rays' weights in the rows between entry and exit, in
/// parts of a row, faded.
void add_cloud(float* power, std::size_t rows, std::size_t columns, const CloudRays& rays,
               const CloudFade& fade);

}  // namespace mapperd::acoustics
