#include "mapperd/acoustics/deposit.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

// sin(2 pi y) for |y| <= 1/4: Taylor's series with the last term fitted; within 4e-7.
MAPPERD_INLINE float sine_turns(float y) {
  const float z = y * y;
  float sum = 39.6F;
  sum = sum * z - 76.7028F;
  sum = sum * z + 81.605165F;
  sum = sum * z - 41.341702F;
  sum = sum * z + 6.2831853F;
  return y * sum;
}

// -ln of a number in (0, 1): exponent and a series of the mantissa's atanh; within 2e-6.
MAPPERD_INLINE float minus_log(float x) {
  std::int32_t bits;
  std::memcpy(&bits, &x, sizeof bits);
  const std::int32_t exponent = (bits - 0x3F3504F3) >> 23;
  bits -= exponent * 0x800000;
  float mantissa;
  std::memcpy(&mantissa, &bits, sizeof mantissa);
  const float t = (mantissa - 1.0F) / (mantissa + 1.0F);
  const float z = t * t;
  const float series = t * (2.0F + z * (0.6666667F + z * (0.4F + z * 0.2857143F)));
  return -(static_cast<float>(exponent) * 0.69314718F + series);
}

// Circular complex Gaussian numbers of the given rms, turned by a phase.
MAPPERD_VECTORISED void gaussian_pressures(const float* __restrict rms,
                                           const float* __restrict phase,
                                           const std::uint32_t* __restrict bits, std::size_t count,
                                           float* __restrict real, float* __restrict imaginary) {
  for (std::size_t i = 0; i < count; ++i) {
    const auto low = static_cast<std::int32_t>(bits[i] & 0xFFFFU);
    const auto high = static_cast<std::int32_t>(bits[i] >> 16);
    const float level = (static_cast<float>(high) + 0.5F) * 0x1p-16F;
    const float pressure = rms[i] * std::sqrt(minus_log(level));
    // Fold the angle: cosine and sine are sines of at most a quarter turn.
    const float turns = phase[i] + static_cast<float>(low) * 0x1p-16F;
    const float angle = turns - static_cast<float>(static_cast<std::int32_t>(turns + 0.5F));
    const float half = std::fabs(angle);
    const float upper = 0.25F - std::fabs(half - 0.25F);
    real[i] = pressure * sine_turns(0.25F - half);
    imaginary[i] = pressure * sine_turns(std::copysign(upper, angle));
  }
}

struct Frame {
  std::int32_t rows, stride, first_column, columns, taps, fractions;
};

// Offset of each echo's first cell; echoes outside get pressure 0 and the offset of the first
// column.
MAPPERD_VECTORISED void cell_offsets(const float* __restrict columns,
                                     const std::int32_t* __restrict rows,
                                     const float* __restrict heard, std::size_t count,
                                     const Frame& frame, std::int32_t* __restrict cell,
                                     std::int32_t* __restrict fraction,
                                     float* __restrict pressure) {
  const std::int32_t before = frame.taps / 2 - 1 + frame.first_column;
  const std::int32_t last = frame.columns - frame.taps;
  const std::int32_t stride = frame.stride;
  const std::int32_t first = frame.first_column;
  const std::int32_t last_row = frame.rows - 1;
  const auto fractions = static_cast<float>(frame.fractions);
  const std::int32_t most = frame.fractions - 1;
  for (std::size_t i = 0; i < count; ++i) {
    const float at = columns[i];
    const auto towards_zero = static_cast<std::int32_t>(at);
    const float truncated = static_cast<float>(towards_zero);
    const std::int32_t whole = towards_zero - (truncated > at ? 1 : 0);
    const auto part = static_cast<std::int32_t>((at - static_cast<float>(whole)) * fractions);
    const std::int32_t column = whole - before;
    const std::int32_t row = rows[i];
    // Negative where one of the four is.
    const std::int32_t inside = row | (last_row - row) | column | (last - column);
    const std::int32_t mask = ~(inside >> 31);
    cell[i] = first + ((row * stride + column) & mask);
    fraction[i] = part < most ? part : most;
    pressure[i] = inside < 0 ? 0.0F : heard[i];
  }
}

// Four complex numbers and two, as one value to the compiler.
using Four = float __attribute__((vector_size(8 * sizeof(float))));
using Pair = float __attribute__((vector_size(4 * sizeof(float))));

template <typename Numbers>
MAPPERD_INLINE void add_scaled(float* cell, const float* taps, const Numbers& number) {
  Numbers sum, part;
  std::memcpy(&sum, cell, sizeof sum);
  std::memcpy(&part, taps, sizeof part);
  sum += part * number;
  std::memcpy(cell, &sum, sizeof sum);
}

// Adds each echo to `taps` cells, an even number; weights are there twice, for both parts. Cells of
// later echoes are fetched in time: rows of the field lie far apart in memory.
MAPPERD_VECTORISED void spread(const float* real, const float* imaginary, const std::int32_t* cell,
                               const std::int32_t* fraction, std::size_t count, std::size_t taps,
                               const float* weights, float* field) {
  for (std::size_t i = 0; i < count; ++i) {
    float* to = field + 2 * static_cast<std::size_t>(cell[i]);
    const float* by = weights + 2 * taps * static_cast<std::size_t>(fraction[i]);
    const float* later = field + 2 * static_cast<std::size_t>(cell[i + kFetchAhead]);
    __builtin_prefetch(later, 1);
    __builtin_prefetch(later + 2 * taps - 1, 1);
    const float re = real[i], im = imaginary[i];
    const Pair pair{re, im, re, im};
    const Four four{re, im, re, im, re, im, re, im};
    std::size_t k = 0;
    for (; k + 4 <= taps; k += 4) {
      add_scaled(to + 2 * k, by + 2 * k, four);
    }
    if (k < taps) {
      add_scaled(to + 2 * k, by + 2 * k, pair);
    }
  }
}

}  // namespace

Deposit::Deposit(const EchoResponse& response, const EchoGrid& grid, std::ptrdiff_t first_column,
                 std::ptrdiff_t columns, std::complex<float>* field)
    : response_(response),
      rows_(static_cast<std::int32_t>(grid.rows)),
      stride_(static_cast<std::int32_t>(grid.columns)),
      first_column_(static_cast<std::int32_t>(first_column)),
      columns_(static_cast<std::int32_t>(columns)),
      field_(field) {
  taps_.reserve(2 * response.fractions * response.tap_count);
  for (std::size_t k = 0; k < response.fractions * response.tap_count; ++k) {
    taps_.insert(taps_.end(), 2, response.taps[k]);
  }
}

void Deposit::add(const Scatterers& nodes) {
  const Frame frame{rows_,
                    stride_,
                    first_column_,
                    columns_,
                    static_cast<std::int32_t>(response_.tap_count),
                    static_cast<std::int32_t>(response_.fractions)};
  cell_offsets(nodes.column, nodes.row, nodes.pressure, nodes.count, frame, cell_.data(),
               fraction_.data(), pressure_.data());
  gaussian_pressures(pressure_.data(), nodes.turns, nodes.bits, nodes.count, real_.data(),
                     imaginary_.data());
  spread(real_.data(), imaginary_.data(), cell_.data(), fraction_.data(), nodes.count,
         response_.tap_count, taps_.data(), reinterpret_cast<float*>(field_));
}

}  // namespace mapperd::acoustics
