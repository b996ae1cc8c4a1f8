#include "convolution.hpp"

#include <algorithm>
#include <cmath>

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
    : convolution_(convolution), parts_(parts), data_(convolution.length_, Number{}) {}

void Convolution::Rows::take(const float* row, float* out) {
  const std::size_t columns = convolution_.columns_;
  const std::size_t lane = outs_.size() * parts_ / 2;
  if (parts_ == 2) {
    for (std::size_t k = 0; k < columns; ++k) {
      data_[k].re[lane] = row[2 * k];
      data_[k].im[lane] = row[2 * k + 1];
    }
  } else if (outs_.size() % 2 == 0) {
    for (std::size_t k = 0; k < columns; ++k) data_[k].re[lane] = row[k];
  } else {
    for (std::size_t k = 0; k < columns; ++k) data_[k].im[lane] = row[k];
  }
  outs_.push_back(out);
  if (outs_.size() == 2 * kLanes / parts_) finish();
}

void Convolution::Rows::finish() {
  if (outs_.empty()) return;
  convolution_.apply(data_.data());
  write();
  outs_.clear();
  std::fill(data_.begin(), data_.end(), Number{});
}

void Convolution::Rows::write() const {
  const Number* from = data_.data() + convolution_.start_;
  for (std::size_t i = 0; i < outs_.size(); ++i) {
    const std::size_t lane = i * parts_ / 2;
    float* out = outs_[i];
    for (std::size_t b = 0; b < convolution_.beams_; ++b) {
      if (parts_ == 2) {
        out[2 * b] = from[b].re[lane];
        out[2 * b + 1] = from[b].im[lane];
      } else {
        out[b] = i % 2 == 0 ? from[b].re[lane] : from[b].im[lane];
      }
    }
  }
}

}  // namespace mapperd::acoustics
