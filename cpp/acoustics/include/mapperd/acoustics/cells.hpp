/// \file
/// \brief Reverberation and noise in the grid of cells, in addition to the echoes of surfaces.
/// Fields are complex, (rows, columns), real and imaginary parts in turn.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::acoustics {

/// Adds an independent complex Gaussian number to each cell, of rms amplitude row_rms[row] times
/// column_rms[column].
void add_gaussian(float* field, std::size_t rows, std::size_t columns, const float* row_rms,
                  const float* column_rms, std::uint64_t key, unsigned threads);

/// The same, with mean power power[row][column].
void add_gaussian_power(float* field, std::size_t rows, std::size_t columns, const float* power,
                        std::uint64_t key, unsigned threads);

}  // namespace mapperd::acoustics
