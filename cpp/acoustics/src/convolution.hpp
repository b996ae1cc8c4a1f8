// A long convolution of many rows by Fourier transform, several rows side by side.
#pragma once

#include <complex>
#include <cstddef>
#include <vector>

namespace mapperd::acoustics {

class Convolution {
 public:
  static constexpr std::size_t kLanes = 8;
  // One number of each row, as one value to the compiler. Without AVX2 the compiler would be
  // content with the alignment of half of it, which is too little for the copies with AVX2.
  using Lanes = float __attribute__((vector_size(kLanes * sizeof(float))));
  struct alignas(kLanes * sizeof(float)) Number {
    Lanes re, im;
  };

  // For rows of `columns`. Output b is the sum over k of taps[k] times column
  // first + b + k - (count - 1) / 2; count is odd.
  Convolution(const float* taps, std::size_t count, std::size_t columns, std::size_t first,
              std::size_t beams);

  // Collects rows and transforms them when enough are there.
  class Rows {
   public:
    // `parts` 2: a row is complex; 1: it is real, and two of them share a lane.
    Rows(const Convolution& convolution, std::size_t parts);
    // Where the next row is to be written, columns * parts numbers; then it is taken.
    float* next();
    void take(float* out);
    void finish();

   private:
    void read();
    void write();
    [[nodiscard]] float* row(std::size_t number);

    const Convolution& convolution_;
    std::size_t parts_;
    std::size_t width_;        // of a row, a whole number of vectors
    std::vector<float> rows_;  // what came in, and what goes out
    std::vector<Number> data_;
    std::vector<float*> outs_;
  };

 private:
  void apply(Number* data) const;

  std::size_t columns_, beams_;
  std::size_t length_;                         // a power of two
  std::size_t start_;                          // where the first beam lies in the result
  std::vector<std::complex<float>> turns_;     // exp(-2 pi i k / length)
  std::vector<std::complex<float>> spectrum_;  // of the taps, in the transform's own order
};

}  // namespace mapperd::acoustics
