/// \file
/// \brief Heap memory taken by allocations.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <algorithm>
#include <cstddef>

namespace mapperd {

/// Bytes that glibc's malloc takes for an allocation on a 64-bit machine: a header of 8, rounded up
/// to 16, and at least 32 (the chunk layout in malloc/malloc.c). Others differ by little.
inline std::size_t allocated_bytes(std::size_t requested) {
  constexpr std::size_t kHeader = 8, kStep = 16, kMin = 32;
  if (requested == 0) return 0;
  return std::max(kMin, (requested + kHeader + kStep - 1) / kStep * kStep);
}

template <typename Vector>
std::size_t allocated_by(const Vector& vector) {
  return allocated_bytes(vector.capacity() * sizeof(typename Vector::value_type));
}

}  // namespace mapperd
