// What the allocator says of the tests' memory, where glibc's own is in use.
#pragma once

#include <cstddef>
#include <cstdlib>  // says whether it is glibc

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define MAPPERD_COUNTS_ALLOCATIONS 1

namespace allocations {

// The sum of what malloc says that each allocation takes.
std::size_t counted();

// What malloc says of itself in all. Small pieces that it keeps at hand after they were freed count
// as in use: too coarse for small maps.
std::size_t in_use();

}  // namespace allocations

#endif
