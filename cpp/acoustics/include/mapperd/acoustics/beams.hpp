/// \file
/// \brief From cells to beams: the range response and the azimuth pattern.
///
/// A grid is rows of columns of one number (a power) or two (a complex amplitude); the responses
/// are real, so the parts of a complex number go through them side by side.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::acoustics {

/// Pressure per cell of range and bearing, borrowed.
struct CellGrid {
  const float* cells;  ///< (rows, columns, parts)
  std::size_t rows, columns;
  std::size_t parts;  ///< 1 or 2
};

/// Weights by which a beam hears the columns, and a row its neighbours.
struct Response {
  const float* taps;
  std::size_t count;        ///< odd
  const float* range_taps;  ///< of rows row - (range_count - 1) / 2 and on
  std::size_t range_count;  ///< odd
};

/// Beam b hears column first + b + k - (count - 1) / 2 by taps[k]; columns and rows outside the
/// grid are silent. `out` is (rows, beams), of as many parts.
void form_beams(const CellGrid& grid, const Response& response, std::size_t first,
                std::size_t beams, float* out, unsigned threads);

/// The same for beams that do not follow the columns' pitch: beam b hears column firsts[b] + k by
/// taps[b * count + k]; count may be even.
void form_beams_at(const CellGrid& grid, const Response& response, const std::int64_t* firsts,
                   std::size_t beams, float* out, unsigned threads);

}  // namespace mapperd::acoustics
