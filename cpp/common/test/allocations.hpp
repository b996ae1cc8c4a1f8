// Memory in use according to glibc's allocator, where that is the allocator.
#pragma once

#include <cstddef>
#include <cstdlib>  // defines __GLIBC__

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define MAPPERD_COUNTS_ALLOCATIONS 1

namespace allocations {

// Sum of malloc_usable_size() of all allocations, bytes.
std::size_t counted();

// Bytes in use according to mallinfo2(). Small freed chunks that it caches count as in use: too
// coarse for small maps.
std::size_t in_use();

}  // namespace allocations

#endif
