/// \file
/// \brief Adds scatterers to the field, in batches so that the compiler can vectorise.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/acoustics/scatter.hpp"

namespace mapperd::acoustics {

constexpr std::size_t kBatch = 512;
constexpr std::size_t kFetchAhead = 16;  ///< echoes

/// A batch of scatterers, one array per quantity.
struct Scatterers {
  std::size_t count;          ///< at most kBatch
  const float* pressure;      ///< rms
  const float* turns;         ///< of phase
  const std::uint32_t* bits;  ///< random, 16 each for level and angle
  const std::int32_t* row;
  const float* column;  ///< of the grid
};

/// Adds the echoes of scatterers to the cells of a complex field.
class Deposit {
 public:
  /// Writes to `columns` columns of the grid's field from `first_column` on, at least as many as an
  /// echo spreads over, and to no others.
  Deposit(const EchoResponse& response, const EchoGrid& grid, std::ptrdiff_t first_column,
          std::ptrdiff_t columns, std::complex<float>* field);

  /// Adds their echoes, except those outside of these columns.
  void add(const Scatterers& nodes);

 private:
  const EchoResponse& response_;
  std::int32_t rows_, stride_, first_column_, columns_;
  std::complex<float>* field_;
  std::vector<float> taps_;  ///< each twice, for the real and the imaginary part
  std::array<float, kBatch> pressure_{}, real_{}, imaginary_{};
  std::array<std::int32_t, kBatch> fraction_{};
  std::array<std::int32_t, kBatch + kFetchAhead>
      cell_{};  ///< beyond the batch: any of the field, to be fetched only
};

}  // namespace mapperd::acoustics
