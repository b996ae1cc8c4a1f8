// Scatterers on their way into the field, a batch at a time so that the compiler can vectorise.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>

#include "acoustics/scatter.hpp"

namespace acoustics {

constexpr std::size_t kBatch = 1024;

class Deposit {
 public:
  // Writes into a field of `columns` a row.
  Deposit(const Hearing& response, std::complex<float>* field, std::ptrdiff_t columns);

  // One scatterer of rms pressure, its phase in turns, and 16 bits each of level and angle; its
  // echo spreads over tap_count columns from `column`.
  void add(float pressure, float turns, std::uint32_t bits, std::ptrdiff_t row,
           std::ptrdiff_t column, std::size_t fraction) {
    const std::size_t i = count_++;
    pressure_[i] = pressure;
    turns_[i] = turns + static_cast<float>(bits & 0xFFFFU) * 0x1p-16F;
    level_[i] = (static_cast<float>(bits >> 16) + 0.5F) * 0x1p-16F;
    cell_[i] = row * columns_ + column;
    taps_[i] = fraction * tap_count_;
    if (count_ == kBatch) {
      flush();
    }
  }

  void flush();

 private:
  void draw();

  std::size_t count_ = 0;
  std::complex<float>* field_;
  std::ptrdiff_t columns_;
  const float* table_;
  std::size_t tap_count_;
  std::array<float, kBatch> pressure_{}, turns_{}, level_{}, real_{}, imaginary_{};
  std::array<std::ptrdiff_t, kBatch> cell_{};
  std::array<std::size_t, kBatch> taps_{};
};

}  // namespace acoustics
