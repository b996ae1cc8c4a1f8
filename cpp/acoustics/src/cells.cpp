#include "mapperd/acoustics/cells.hpp"

#include <algorithm>
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

// Amplitudes of cells whose power is the square of row_rms times rms, and `extra_power`: that of
// each column or, of step 0, the first one for all.
MAPPERD_VECTORISED void total_rms(const float* __restrict rms, float row_rms,
                                  const float* __restrict extra_power, std::size_t step,
                                  std::size_t columns, float* __restrict total) {
  if (step == 0) {
    const float alike = extra_power[0];
    for (std::size_t i = 0; i < columns; ++i) {
      const float own = row_rms * rms[i];
      const float sum = own * own + alike;
      total[i] = std::sqrt(sum > 0.0F ? sum : 0.0F);
    }
    return;
  }
  for (std::size_t i = 0; i < columns; ++i) {
    const float own = row_rms * rms[i];
    const float sum = own * own + extra_power[i];
    total[i] = std::sqrt(sum > 0.0F ? sum : 0.0F);
  }
}

// Amplitudes of powers between the coarse columns `below` and the next ones.
MAPPERD_VECTORISED void roots(const float* __restrict power, const std::int32_t* __restrict below,
                              const float* __restrict part, std::size_t columns,
                              float* __restrict amplitude) {
  for (std::size_t i = 0; i < columns; ++i) {
    const float low = power[below[i]];
    const float between = low + part[i] * (power[below[i] + 1] - low);
    amplitude[i] = std::sqrt(between > 0.0F ? between : 0.0F);
  }
}

MAPPERD_VECTORISED void roots(const float* __restrict power, std::size_t columns,
                              float* __restrict amplitude) {
  for (std::size_t i = 0; i < columns; ++i) {
    amplitude[i] = std::sqrt(power[i] > 0.0F ? power[i] : 0.0F);
  }
}

MAPPERD_VECTORISED void squares(const float* cells, std::size_t columns, float* to) {
  for (std::size_t i = 0; i < columns; ++i) {
    to[i] = cells[2 * i] * cells[2 * i] + cells[2 * i + 1] * cells[2 * i + 1];
  }
}

// Adds a ray's weight from a row on, less in the first one if it begins within that.
void begin_at(double row, double weight, std::size_t rows, double* column, std::size_t stride) {
  if (!(row < static_cast<double>(rows))) return;
  const auto whole = static_cast<std::size_t>(row);
  const double part = row - static_cast<double>(whole);
  column[whole * stride] += weight * (1.0 - part);
  column[(whole + 1) * stride] += weight * part;
}

}  // namespace

void add_gaussian(float* field, std::size_t rows, std::size_t columns, const CellLevels& levels,
                  std::uint64_t key, unsigned threads) {
  in_row_bands(rows, threads, [=](std::size_t first, std::size_t last) {
    std::vector<float> unit(2 * columns);
    std::vector<float> sum(columns);
    for (std::size_t row = first; row < last; ++row) {
      const float* rms = levels.column_rms;
      float row_rms = levels.row_rms[row];
      if (levels.extra_power != nullptr) {
        const float* extra = levels.extra_power + row * levels.extra_columns;
        total_rms(rms, row_rms, extra, levels.extra_columns > 1 ? 1 : 0, columns, sum.data());
        rms = sum.data();
        row_rms = 1.0F;
      }
      if (row_rms > 0.0F) {
        complex_gaussians(key, row * columns, columns, unit.data());
        add_scaled(field + 2 * row * columns, unit.data(), rms, row_rms, columns);
      }
    }
  });
}

void add_gaussian_power(float* field, std::size_t rows, std::size_t columns, const float* power,
                        const CoarseColumns& coarse, std::uint64_t key, unsigned threads) {
  std::vector<std::int32_t> below(columns);
  std::vector<float> part(columns);
  const double last = static_cast<double>(coarse.count) - 1.0;
  for (std::size_t i = 0; i < columns; ++i) {
    const double at = (static_cast<double>(i) - coarse.first) / coarse.step;
    const double within = std::clamp(at, 0.0, last);
    // Beyond the last column stands a copy of it.
    below[i] = static_cast<std::int32_t>(within);
    part[i] = static_cast<float>(within - static_cast<double>(below[i]));
  }
  const bool coincide = coarse.count == columns && coarse.first == 0.0 && coarse.step == 1.0;
  in_row_bands(rows, threads, [&](std::size_t first, std::size_t end) {
    std::vector<float> unit(2 * columns);
    std::vector<float> rms(columns);
    std::vector<float> of_row(coarse.count + 1);
    for (std::size_t row = first; row < end; ++row) {
      const float* from = power + row * coarse.count;
      if (coincide) {
        roots(from, columns, rms.data());
      } else {
        std::copy_n(from, coarse.count, of_row.begin());
        of_row.back() = of_row[coarse.count - 1];
        roots(of_row.data(), below.data(), part.data(), columns, rms.data());
      }
      complex_gaussians(key, row * columns, columns, unit.data());
      add_scaled(field + 2 * row * columns, unit.data(), rms.data(), 1.0F, columns);
    }
  });
}

void block_powers(const float* cells, std::size_t parts, std::size_t rows, std::size_t columns,
                  std::size_t width, float* out, unsigned threads) {
  const std::size_t blocks = (columns + width - 1) / width;
  in_row_bands(rows, threads, [=](std::size_t first, std::size_t end) {
    std::vector<float> power(columns);
    for (std::size_t row = first; row < end; ++row) {
      const float* from = cells + row * columns * parts;
      if (parts == 2) {
        squares(from, columns, power.data());
        from = power.data();
      }
      for (std::size_t block = 0; block < blocks; ++block) {
        const std::size_t begin = block * width;
        const std::size_t size = std::min(width, columns - begin);
        float sum = 0.0F;
        for (std::size_t i = begin; i < begin + size; ++i) sum += from[i];
        out[row * blocks + block] = sum / static_cast<float>(size);
      }
    }
  });
}

namespace {

template <typename Real>
void sum_rows(const Real* power, std::size_t rows, std::size_t columns, double energy, double kept,
              Real* out) {
  std::vector<double> sum(columns, 0.0);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t i = 0; i < columns; ++i) {
      out[row * columns + i] = static_cast<Real>(sum[i]);
      sum[i] = energy * static_cast<double>(power[row * columns + i]) + kept * sum[i];
    }
  }
}

// Columns between the first and the last weight of a row that is not zero.
struct Part {
  std::size_t first, last;
};

template <typename Real>
std::vector<Part> parts_of(const Real* weights, std::size_t rows, std::size_t columns) {
  std::vector<Part> parts(rows, Part{0, columns});
  for (std::size_t row = 0; row < rows; ++row) {
    Part& part = parts[row];
    const Real* of_row = weights + row * columns;
    while (part.first < part.last && of_row[part.first] == Real{0}) ++part.first;
    while (part.first < part.last && of_row[part.last - 1] == Real{0}) --part.last;
  }
  return parts;
}

MAPPERD_VECTORISED void add_times(float by, const float* __restrict from, std::size_t count,
                                  float* __restrict to) {
  for (std::size_t i = 0; i < count; ++i) to[i] += by * from[i];
}

MAPPERD_VECTORISED void add_times(double by, const double* __restrict from, std::size_t count,
                                  double* __restrict to) {
  for (std::size_t i = 0; i < count; ++i) to[i] += by * from[i];
}

template <typename Real>
void multiply(const Real* power, std::size_t rows, std::size_t columns, const Real* weights,
              std::size_t out_columns, Real* out, unsigned threads) {
  const std::vector<Part> parts = parts_of(weights, columns, out_columns);
  in_row_bands(rows, threads, [&, out_columns](std::size_t row, std::size_t last) {
    for (; row < last; ++row) {
      Real* to = out + row * out_columns;
      std::fill_n(to, out_columns, Real{0});
      for (std::size_t column = 0; column < columns; ++column) {
        const auto [begin, end] = parts[column];
        add_times(power[row * columns + column], weights + column * out_columns + begin,
                  end - begin, to + begin);
      }
    }
  });
}

}  // namespace

void spread_columns(const float* power, std::size_t rows, std::size_t columns, const float* weights,
                    std::size_t out_columns, float* out, unsigned threads) {
  multiply(power, rows, columns, weights, out_columns, out, threads);
}

void spread_columns(const double* power, std::size_t rows, std::size_t columns,
                    const double* weights, std::size_t out_columns, double* out, unsigned threads) {
  multiply(power, rows, columns, weights, out_columns, out, threads);
}

void decaying_sum(const float* power, std::size_t rows, std::size_t columns, double energy,
                  double kept, float* out) {
  sum_rows(power, rows, columns, energy, kept, out);
}

void decaying_sum(const double* power, std::size_t rows, std::size_t columns, double energy,
                  double kept, double* out) {
  sum_rows(power, rows, columns, energy, kept, out);
}

MAPPERD_VECTORISED void box_crossing(const double* low, const double* high, std::size_t count,
                                     const float* direction, const double* reach_m, double* enter,
                                     double* leave) {
  for (std::size_t i = 0; i < count; ++i) {
    double from = 0.0, to = reach_m[i];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto along = static_cast<double>(direction[3 * i + axis]);
      const double a = low[axis] / along, b = high[axis] / along;
      // Along the low face a is 0 / 0, which the comparisons pass over: the ray is inside. Along
      // the high face b is, and the ray misses: boxes side by side share no ray.
      from = std::max(from, std::min(a, b));
      to = std::min(to, std::max(a, b));
    }
    leave[i] = std::max(to, 0.0);
    enter[i] = std::min(from, leave[i]);
  }
}

void add_cloud(float* power, std::size_t rows, std::size_t columns, const CloudRays& rays,
               const CloudFade& fade) {
  // Growth of the sum from the row before.
  std::vector<double> growth((rows + 1) * columns, 0.0);
  for (std::size_t i = 0; i < rays.count; ++i) {
    double* column = growth.data() + rays.column[i];
    begin_at(rays.enter_row[i], rays.weight[i], rows, column, columns);
    begin_at(rays.leave_row[i], -rays.weight[i], rows, column, columns);
  }
  std::vector<double> sum(columns, 0.0);
  for (std::size_t row = 0; row < rows; ++row) {
    const double faded = fade.row[row];
    const double level = fade.level[row];
    for (std::size_t i = 0; i < columns; ++i) {
      sum[i] += growth[row * columns + i];
      const double left = std::min(faded * fade.column[i], 1.0);
      power[row * columns + i] += static_cast<float>(std::max(sum[i], 0.0) * left * level);
    }
  }
}

}  // namespace mapperd::acoustics
