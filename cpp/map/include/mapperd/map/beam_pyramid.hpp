// Pyramids over a ping's beams: what holds for any run of neighbouring beams, in constant time.
//
// Level k holds the answer for every run of 2^k beams; a run of any length is two of them that
// overlap (the sparse table of Bender and Farach-Colton, LATIN 2000).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace mapperd::map {

// Floor of the binary logarithm of n >= 1.
inline std::size_t floor_log2(std::size_t n) {
  return 63 - static_cast<std::size_t>(__builtin_clzll(n));
}

// The smallest or the largest value of a run of beams.
template <typename Better>  // double(double, double)
class RunExtreme {
 public:
  RunExtreme() = default;
  explicit RunExtreme(const std::vector<double>& values) : beams_(values.size()), table_(values) {
    for (std::size_t half = 1; 2 * half <= beams_; half *= 2) {
      const std::size_t below = table_.size() - beams_;
      for (std::size_t j = 0; j < beams_; ++j) {
        const std::size_t other = std::min(j + half, beams_ - 1);
        table_.push_back(Better{}(table_[below + j], table_[below + other]));
      }
    }
  }

  // Of beams first to last, both counted.
  double of(std::size_t first, std::size_t last) const {
    const std::size_t level = floor_log2(last - first + 1);
    const double* row = &table_[level * beams_];
    return Better{}(row[first], row[last + 1 - (std::size_t{1} << level)]);
  }

 private:
  std::size_t beams_ = 0;
  std::vector<double> table_;
};

struct Smaller {
  double operator()(double a, double b) const { return a < b ? a : b; }
};
struct Larger {
  double operator()(double a, double b) const { return a > b ? a : b; }
};

// Which rows hold a return, one bit a row, for any run of beams.
class ReturnRows {
 public:
  ReturnRows() = default;
  ReturnRows(std::size_t beams, std::size_t rows)
      : beams_(beams), words_(rows / 64 + 1), bits_(beams * words_) {}

  void mark(std::size_t beam, std::size_t row) {
    bits_[beam * words_ + row / 64] |= std::uint64_t{1} << (row % 64);
  }
  // After the last mark.
  void build() {
    for (std::size_t half = 1; 2 * half <= beams_; half *= 2) {
      const std::size_t below = bits_.size() - beams_ * words_;
      bits_.resize(bits_.size() + beams_ * words_);
      for (std::size_t j = 0; j < beams_; ++j) {
        const std::uint64_t* one = &bits_[below + j * words_];
        const std::uint64_t* other = &bits_[below + std::min(j + half, beams_ - 1) * words_];
        std::uint64_t* both = &bits_[below + (beams_ + j) * words_];
        for (std::size_t i = 0; i < words_; ++i) both[i] = one[i] | other[i];
      }
    }
  }

  // The beam's first row with a return from `row` on; far beyond its last row if there is none.
  std::size_t next(std::size_t beam, std::size_t row) const {
    for (std::size_t i = row / 64; i < words_; ++i) {
      std::uint64_t bits = bits_[beam * words_ + i];
      if (i == row / 64) bits &= ~std::uint64_t{0} << (row % 64);
      if (bits == 0) continue;
      row = 64 * i;
      while ((bits & 1U) == 0) {
        bits >>= 1U;
        ++row;
      }
      return row;
    }
    return 64 * words_;
  }

  // A beam's rows from <= row < end, at most 64 of them, `from` in the lowest bit.
  std::uint64_t rows_of(std::size_t beam, std::size_t from, std::size_t end) const {
    if (from >= end) return 0;
    const std::uint64_t* bits = &bits_[beam * words_ + from / 64];
    const std::size_t shift = from % 64;
    std::uint64_t rows = bits[0] >> shift;
    if (shift + (end - from) > 64) rows |= bits[1] << (64 - shift);
    return rows & (~std::uint64_t{0} >> (64 - (end - from)));
  }

  // A return in any of the beams first to last, in rows from <= row < end.
  bool any(std::size_t first, std::size_t last, std::size_t from, std::size_t end) const {
    if (from >= end) return false;
    const std::size_t level = floor_log2(last - first + 1);
    const std::size_t second = last + 1 - (std::size_t{1} << level);
    const std::uint64_t* one = &bits_[(level * beams_ + first) * words_];
    const std::uint64_t* other = &bits_[(level * beams_ + second) * words_];
    const std::size_t word = from / 64;
    const std::size_t last_word = (end - 1) / 64;
    const std::uint64_t head = ~std::uint64_t{0} << (from % 64);
    const std::uint64_t tail = ~std::uint64_t{0} >> (63 - (end - 1) % 64);
    for (std::size_t i = word; i <= last_word; ++i) {
      std::uint64_t bits = one[i] | other[i];
      if (i == word) bits &= head;
      if (i == last_word) bits &= tail;
      if (bits != 0) return true;
    }
    return false;
  }

 private:
  std::size_t beams_ = 0;
  std::size_t words_ = 0;
  std::vector<std::uint64_t> bits_;
};

}  // namespace mapperd::map
