#include "convolution.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

using Lanes = Convolution::Lanes;
using Number = Convolution::Number;

MAPPERD_INLINE Number turned(const Number& number, const std::complex<float>& by) {
  return {number.re * by.real() - number.im * by.imag(),
          number.re * by.imag() + number.im * by.real()};
}

MAPPERD_INLINE Number operator+(const Number& a, const Number& b) {
  return {a.re + b.re, a.im + b.im};
}

MAPPERD_INLINE Number operator-(const Number& a, const Number& b) {
  return {a.re - b.re, a.im - b.im};
}

// Times i.
MAPPERD_INLINE Number quarter(const Number& a) { return {-a.im, a.re}; }

// Sum and difference of neighbours: the stage that is left over when their number is odd.
MAPPERD_INLINE void pairs(Number* data, std::size_t length) {
  for (std::size_t k = 0; k < length; k += 2) {
    const Number a = data[k];
    data[k] = a + data[k + 1];
    data[k + 1] = a - data[k + 1];
  }
}

// Decimation in frequency: natural order in, bit-reversed order out (Gentleman and Sande 1966), two
// stages at a time.
MAPPERD_VECTORISED void forward(Number* data, std::size_t length,
                                const std::complex<float>* turns) {
  std::size_t size = length;
  for (; size >= 4; size /= 4) {
    const std::size_t q = size / 4;
    const std::size_t stride = length / size;
    for (Number* at = data; at < data + length; at += size) {
      for (std::size_t k = 0; k < q; ++k) {
        const Number even = at[k] + at[k + 2 * q];
        const Number odd = at[k + q] + at[k + 3 * q];
        const Number even_gap = at[k] - at[k + 2 * q];
        const Number odd_gap = quarter(at[k + q] - at[k + 3 * q]);
        at[k] = even + odd;
        at[k + q] = turned(even - odd, turns[2 * k * stride]);
        at[k + 2 * q] = turned(even_gap - odd_gap, turns[k * stride]);
        at[k + 3 * q] = turned(even_gap + odd_gap, turns[3 * k * stride]);
      }
    }
  }
  if (size == 2) pairs(data, length);
}

// Its reverse, stage by stage, times the length.
MAPPERD_VECTORISED void backward(Number* data, std::size_t length,
                                 const std::complex<float>* turns) {
  std::size_t size = 1;
  while (4 * size <= length) size *= 4;
  const bool left_over = size != length;
  if (left_over) pairs(data, length);
  for (size = left_over ? 8 : 4; size <= length; size *= 4) {
    const std::size_t q = size / 4;
    const std::size_t stride = length / size;
    for (Number* at = data; at < data + length; at += size) {
      for (std::size_t k = 0; k < q; ++k) {
        const Number first = at[k];
        const Number second = turned(at[k + q], std::conj(turns[2 * k * stride]));
        const Number third = turned(at[k + 2 * q], std::conj(turns[k * stride]));
        const Number fourth = turned(at[k + 3 * q], std::conj(turns[3 * k * stride]));
        const Number sum = third + fourth;
        const Number gap = quarter(third - fourth);
        at[k] = first + second + sum;
        at[k + q] = first - second + gap;
        at[k + 2 * q] = first + second - sum;
        at[k + 3 * q] = first - second - gap;
      }
    }
  }
}

MAPPERD_VECTORISED void multiply(Number* data, std::size_t length, const std::complex<float>* by) {
  for (std::size_t k = 0; k < length; ++k) data[k] = turned(data[k], by[k]);
}

#if defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
#define MAPPERD_SHUFFLES
#endif
#endif

// Turns eight rows of eight into eight columns.
MAPPERD_INLINE void turn_block(Lanes (&block)[8]) {
#ifdef MAPPERD_SHUFFLES
  Lanes pairs[8], fours[8];
  for (std::size_t k = 0; k < 8; k += 2) {
    const Lanes a = block[k], b = block[k + 1];
    pairs[k] = __builtin_shufflevector(a, b, 0, 8, 1, 9, 4, 12, 5, 13);
    pairs[k + 1] = __builtin_shufflevector(a, b, 2, 10, 3, 11, 6, 14, 7, 15);
  }
  for (std::size_t k = 0; k < 8; k += 4) {
    for (std::size_t half = 0; half < 2; ++half) {
      const Lanes a = pairs[k + half], b = pairs[k + half + 2];
      fours[k + 2 * half] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
      fours[k + 2 * half + 1] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    }
  }
  for (std::size_t k = 0; k < 4; ++k) {
    const Lanes a = fours[k], b = fours[k + 4];
    block[k] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11);
    block[k + 4] = __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
  }
#else
  Lanes columns[8];
  for (std::size_t i = 0; i < 8; ++i) {
    for (std::size_t k = 0; k < 8; ++k) columns[k][i] = block[i][k];
  }
  std::copy(columns, columns + 8, block);
#endif
}

// Rows of `width` numbers, `rows_apart`, into lanes of vectors `vectors_apart`.
MAPPERD_VECTORISED void into_lanes(const float* rows, std::size_t rows_apart, std::size_t width,
                                   float* to, std::size_t vectors_apart) {
  for (std::size_t k = 0; k < width; k += 8) {
    Lanes block[8];
    for (std::size_t i = 0; i < 8; ++i) {
      std::memcpy(&block[i], rows + i * rows_apart + k, sizeof(Lanes));
    }
    turn_block(block);
    for (std::size_t i = 0; i < 8; ++i) {
      std::memcpy(to + (k + i) * vectors_apart, &block[i], sizeof(Lanes));
    }
  }
}

// The reverse.
MAPPERD_VECTORISED void from_lanes(const float* from, std::size_t vectors_apart, std::size_t width,
                                   float* rows, std::size_t rows_apart) {
  for (std::size_t k = 0; k < width; k += 8) {
    Lanes block[8];
    for (std::size_t i = 0; i < 8; ++i) {
      std::memcpy(&block[i], from + (k + i) * vectors_apart, sizeof(Lanes));
    }
    turn_block(block);
    for (std::size_t i = 0; i < 8; ++i) {
      std::memcpy(rows + i * rows_apart + k, &block[i], sizeof(Lanes));
    }
  }
}

}  // namespace

Convolution::Convolution(const float* taps, std::size_t count, std::size_t columns,
                         std::size_t first, std::size_t beams)
    : columns_(columns), beams_(beams), length_(1), start_(0) {
  // Taps that reach past every column are heard by no beam.
  const std::size_t farthest = std::max(columns, first + beams);
  const std::size_t reach = std::min(count / 2, farthest);
  taps += count / 2 - reach;
  // A circular transform of this length: wrap-around only affects results that are not read.
  const std::size_t behind = columns > first ? columns - first : 0;
  while (length_ < std::max({columns, behind + reach, first + beams + reach})) length_ *= 2;
  start_ = first;
  turns_.reserve(length_);
  for (std::size_t k = 0; k < length_; ++k) {
    const double angle =
        -2.0 * 3.14159265358979323846 * static_cast<double>(k) / static_cast<double>(length_);
    turns_.emplace_back(static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle)));
  }
  std::vector<Number> data(length_, Number{});
  // Output b hears column b + offset by taps[reach + offset]: the taps' mirror image, about 0.
  for (std::size_t k = 0; k <= 2 * reach; ++k) {
    data[(length_ + reach - k) % length_].re[0] += taps[k] / static_cast<float>(length_);
  }
  forward(data.data(), length_, turns_.data());
  spectrum_.reserve(length_);
  for (const Number& number : data) spectrum_.emplace_back(number.re[0], number.im[0]);
}

void Convolution::apply(Number* data) const {
  forward(data, length_, turns_.data());
  multiply(data, length_, spectrum_.data());
  backward(data, length_, turns_.data());
}

Convolution::Rows::Rows(const Convolution& convolution, std::size_t parts)
    : convolution_(convolution),
      parts_(parts),
      width_((std::max(convolution.columns_, convolution.beams_) * parts + kLanes - 1) / kLanes *
             kLanes),
      rows_(2 * kLanes / parts * width_, 0.0F),
      data_(std::max(convolution.length_, convolution.start_ + width_), Number{}) {}

float* Convolution::Rows::row(std::size_t number) { return rows_.data() + number * width_; }

float* Convolution::Rows::next() { return row(outs_.size()); }

void Convolution::Rows::take(float* out) {
  outs_.push_back(out);
  if (outs_.size() == 2 * kLanes / parts_) finish();
}

void Convolution::Rows::finish() {
  if (outs_.empty()) return;
  // Two real rows share a lane: nothing of an earlier batch may stand beside the last row.
  std::fill(rows_.begin() + static_cast<std::ptrdiff_t>(outs_.size() * width_), rows_.end(), 0.0F);
  read();
  convolution_.apply(data_.data());
  write();
  outs_.clear();
}

void Convolution::Rows::read() {
  auto* to = reinterpret_cast<float*>(data_.data());
  if (parts_ == 2) {
    into_lanes(rows_.data(), width_, width_, to, kLanes);
  } else {
    // Even rows are the real parts.
    into_lanes(rows_.data(), 2 * width_, width_, to, 2 * kLanes);
    into_lanes(rows_.data() + width_, 2 * width_, width_, to + kLanes, 2 * kLanes);
  }
  std::fill(data_.begin() + static_cast<std::ptrdiff_t>(convolution_.columns_), data_.end(),
            Number{});
}

void Convolution::Rows::write() {
  const auto* from = reinterpret_cast<const float*>(data_.data() + convolution_.start_);
  const std::size_t size = convolution_.beams_ * parts_;
  if (parts_ == 2) {
    from_lanes(from, kLanes, width_, rows_.data(), width_);
  } else {
    from_lanes(from, 2 * kLanes, width_, rows_.data(), 2 * width_);
    from_lanes(from + kLanes, 2 * kLanes, width_, rows_.data() + width_, 2 * width_);
  }
  for (std::size_t i = 0; i < outs_.size(); ++i) std::copy_n(row(i), size, outs_[i]);
}

}  // namespace mapperd::acoustics
