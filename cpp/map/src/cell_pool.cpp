#include "mapperd/map/cell_pool.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

namespace mapperd::map {

void CellPool::swap(CellPool& other) noexcept {
  std::swap(count_bytes_, other.count_bytes_);
  std::swap(slot_bytes_, other.slot_bytes_);
  chunks_.swap(other.chunks_);
  free_.swap(other.free_);
  std::swap(used_, other.used_);
}

std::size_t CellPool::memory_bytes() const {
  return allocated_by(chunks_) + allocated_by(free_) +
         chunks_.size() * allocated_bytes(kChunk * slot_bytes_);
}

void CellPool::reserve(std::size_t slots) { chunks_.reserve(chunks_.size() + slots / kChunk + 1); }

void CellPool::take(std::size_t count, std::vector<std::uint32_t>& slots) {
  const std::lock_guard<std::mutex> lock(mutex_);
  for (; count > 0 && !free_.empty(); --count) {
    slots.push_back(free_.back());
    free_.pop_back();
  }
  // In descending order: they are taken from the back.
  if (used_ + count > chunks_.size() * kChunk) {
    chunks_.emplace_back(new std::byte[kChunk * slot_bytes_]);
  }
  for (std::size_t i = count; i > 0; --i) {
    slots.push_back(static_cast<std::uint32_t>(used_ + i - 1));
  }
  used_ += count;
}

void CellPool::give_back(std::vector<std::uint32_t>& slots) {
  const std::lock_guard<std::mutex> lock(mutex_);
  // Those taken last and never used become new again.
  std::sort(slots.begin(), slots.end());
  while (!slots.empty() && slots.back() + 1 == used_) {
    slots.pop_back();
    --used_;
  }
  free_.insert(free_.end(), slots.rbegin(), slots.rend());
  slots.clear();
}

}  // namespace mapperd::map
