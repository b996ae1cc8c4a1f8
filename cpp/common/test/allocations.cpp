#include "allocations.hpp"

#ifdef MAPPERD_COUNTS_ALLOCATIONS

#include <malloc.h>

#include <atomic>
#include <new>

namespace {

std::atomic<std::size_t> counter{0};

// A block's size and the word in front of it.
std::size_t taken_by(void* p) { return malloc_usable_size(p) + sizeof(std::size_t); }

}  // namespace

namespace allocations {

std::size_t counted() { return counter; }

std::size_t in_use() {
  const struct mallinfo2 info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

}  // namespace allocations

void* operator new(std::size_t bytes) {
  void* const p = std::malloc(bytes == 0 ? 1 : bytes);
  if (p == nullptr) throw std::bad_alloc();
  counter += taken_by(p);
  return p;
}

void operator delete(void* p) noexcept {
  if (p == nullptr) return;
  counter -= taken_by(p);
  std::free(p);
}

void operator delete(void* p, std::size_t /*bytes*/) noexcept { operator delete(p); }

#endif
