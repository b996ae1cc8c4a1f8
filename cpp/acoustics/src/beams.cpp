#include "mapperd/acoustics/beams.hpp"

#include <algorithm>
#include <vector>

#include "convolution.hpp"
#include "mapperd/acoustics/row_bands.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

// Above so many taps the Fourier transform is quicker than the sum itself.
constexpr std::size_t kDirectTaps = 64;

MAPPERD_VECTORISED void add_weighted(float* to, const float* from, float weight,
                                     std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) to[i] += weight * from[i];
}

// A row and its neighbours, weighted.
MAPPERD_VECTORISED void weigh_three(const float* __restrict from, std::size_t width,
                                    const float* taps, float* __restrict to) {
  const float before = taps[0], own = taps[1], after = taps[2];
  for (std::size_t i = 0; i < width; ++i) {
    to[i] = before * from[i] + own * from[width + i] + after * from[2 * width + i];
  }
}

// sum over k of taps[k] from[i + k * parts], in pieces that stay in registers.
MAPPERD_VECTORISED void slide(const float* from, const float* taps, std::size_t tap_count,
                              std::size_t parts, std::size_t count, float* to) {
  constexpr std::size_t kPiece = 32;
  std::size_t start = 0;
  for (; start + kPiece <= count; start += kPiece) {
    float sum[kPiece] = {};
    for (std::size_t k = 0; k < tap_count; ++k) {
      const float* at = from + start + k * parts;
      for (std::size_t i = 0; i < kPiece; ++i) sum[i] += taps[k] * at[i];
    }
    std::copy(sum, sum + kPiece, to + start);
  }
  for (; start < count; ++start) {
    float sum = 0.0F;
    for (std::size_t k = 0; k < tap_count; ++k) sum += taps[k] * from[start + k * parts];
    to[start] = sum;
  }
}

// A row as the range response leaves it, in `to`, which holds columns * parts numbers.
void spread_row(const CellGrid& grid, const Response& response, std::size_t row, float* to) {
  const std::size_t width = grid.columns * grid.parts;
  const std::size_t reach = response.range_count / 2;
  if (response.range_count == 3 && row > 0 && row + 1 < grid.rows) {
    weigh_three(grid.cells + (row - 1) * width, width, response.range_taps, to);
    return;
  }
  std::fill(to, to + width, 0.0F);
  for (std::size_t k = 0; k < response.range_count; ++k) {
    if (row + k < reach || row + k - reach >= grid.rows) continue;
    add_weighted(to, grid.cells + (row + k - reach) * width, response.range_taps[k], width);
  }
}

void form_directly(const CellGrid& grid, const Response& response, std::size_t first,
                   std::size_t beams, float* out, unsigned threads) {
  const std::size_t reach = response.count / 2;
  const std::size_t width = beams * grid.parts;
  // Silence on both sides, wide enough for every beam's taps.
  const std::size_t end = std::max(grid.columns, first + beams) + reach;
  in_row_bands(grid.rows, threads, [=](std::size_t row, std::size_t last) {
    std::vector<float> padded((reach + end) * grid.parts);
    for (; row < last; ++row) {
      spread_row(grid, response, row, padded.data() + reach * grid.parts);
      slide(padded.data() + first * grid.parts, response.taps, response.count, grid.parts, width,
            out + row * width);
    }
  });
}

void form_by_transform(const CellGrid& grid, const Response& response, std::size_t first,
                       std::size_t beams, float* out, unsigned threads) {
  const Convolution convolution(response.taps, response.count, grid.columns, first, beams);
  // Two real rows are transformed as one: the same two whatever the number of threads.
  const std::size_t together = 2 / grid.parts;
  in_row_bands((grid.rows + together - 1) / together, threads,
               [&](std::size_t from, std::size_t to) {
                 Convolution::Rows rows(convolution, grid.parts);
                 const std::size_t last = std::min(to * together, grid.rows);
                 for (std::size_t row = from * together; row < last; ++row) {
                   spread_row(grid, response, row, rows.next());
                   rows.take(out + row * beams * grid.parts);
                 }
                 rows.finish();
               });
}

}  // namespace

void form_beams(const CellGrid& grid, const Response& response, std::size_t first,
                std::size_t beams, float* out, unsigned threads) {
  const auto form = response.count <= kDirectTaps ? form_directly : form_by_transform;
  form(grid, response, first, beams, out, threads);
}

void form_beams_at(const CellGrid& grid, const Response& response, const std::int64_t* firsts,
                   std::size_t beams, float* out, unsigned threads) {
  const auto columns = static_cast<std::int64_t>(grid.columns);
  in_row_bands(grid.rows, threads, [=](std::size_t row, std::size_t last) {
    std::vector<float> spread(grid.columns * grid.parts);
    for (; row < last; ++row) {
      spread_row(grid, response, row, spread.data());
      for (std::size_t beam = 0; beam < beams; ++beam) {
        float sum[2] = {};
        for (std::size_t k = 0; k < response.count; ++k) {
          const std::int64_t column = firsts[beam] + static_cast<std::int64_t>(k);
          if (column < 0 || column >= columns) continue;
          const float* cell = spread.data() + static_cast<std::size_t>(column) * grid.parts;
          const float weight = response.taps[beam * response.count + k];
          for (std::size_t part = 0; part < grid.parts; ++part) sum[part] += weight * cell[part];
        }
        std::copy(sum, sum + grid.parts, out + (row * beams + beam) * grid.parts);
      }
    }
  });
}

}  // namespace mapperd::acoustics
