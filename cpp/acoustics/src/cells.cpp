#include "mapperd/acoustics/cells.hpp"

#include <cmath>
#include <vector>

#include "mapperd/acoustics/complex_gaussian.hpp"
#include "mapperd/acoustics/row_bands.hpp"

namespace mapperd::acoustics {

namespace {

MAPPERD_VECTORISED void add_scaled(float* field, const float* unit, const float* rms, float row_rms,
                                   std::size_t columns) {
  for (std::size_t i = 0; i < columns; ++i) {
    const float scale = row_rms * rms[i];
    field[2 * i] += scale * unit[2 * i];
    field[2 * i + 1] += scale * unit[2 * i + 1];
  }
}

MAPPERD_VECTORISED void roots(const float* power, float* amplitude, std::size_t columns) {
  for (std::size_t i = 0; i < columns; ++i) {
    amplitude[i] = std::sqrt(power[i] > 0.0F ? power[i] : 0.0F);
  }
}

}  // namespace

void add_gaussian(float* field, std::size_t rows, std::size_t columns, const float* row_rms,
                  const float* column_rms, std::uint64_t key, unsigned threads) {
  in_row_bands(rows, threads, [=](std::size_t first, std::size_t last) {
    std::vector<float> unit(2 * columns);
    for (std::size_t row = first; row < last; ++row) {
      if (!(row_rms[row] > 0.0F)) continue;
      complex_gaussians(key, row * columns, columns, unit.data());
      add_scaled(field + 2 * row * columns, unit.data(), column_rms, row_rms[row], columns);
    }
  });
}

void add_gaussian_power(float* field, std::size_t rows, std::size_t columns, const float* power,
                        std::uint64_t key, unsigned threads) {
  in_row_bands(rows, threads, [=](std::size_t first, std::size_t last) {
    std::vector<float> unit(2 * columns);
    std::vector<float> rms(columns);
    for (std::size_t row = first; row < last; ++row) {
      complex_gaussians(key, row * columns, columns, unit.data());
      roots(power + row * columns, rms.data(), columns);
      add_scaled(field + 2 * row * columns, unit.data(), rms.data(), 1.0F, columns);
    }
  });
}

}  // namespace mapperd::acoustics
