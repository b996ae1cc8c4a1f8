// What an allocation costs.
#pragma once

#include <algorithm>
#include <cstddef>

namespace mapperd {

// Bytes that glibc's malloc takes for an allocation on a 64-bit machine: a header of 8, rounded up
// to 16, and at least 32 (the chunk layout in malloc/malloc.c). Others differ by little.
inline std::size_t allocated_bytes(std::size_t requested) {
  constexpr std::size_t header = 8, step = 16, least = 32;
  if (requested == 0) return 0;
  return std::max(least, (requested + header + step - 1) / step * step);
}

template <typename Vector>
std::size_t allocated_by(const Vector& vector) {
  return allocated_bytes(vector.capacity() * sizeof(typename Vector::value_type));
}

}  // namespace mapperd
