/// \file
/// \brief Memory for cells of 4 x 4 x 4 voxels that are held voxel by voxel, in equal slots.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "mapperd/common/memory_use.hpp"

namespace mapperd::map {

inline constexpr int kCellEdge = 4;
inline constexpr int kCellVoxels = kCellEdge * kCellEdge * kCellEdge;

/// The voxels of one cell, x fastest: log-odds, then counts of one or two bytes.
class CellVoxels {
 public:
  CellVoxels(std::byte* slot, int count_bytes) : slot_(slot), count_bytes_(count_bytes) {}

  std::int16_t* units() const { return reinterpret_cast<std::int16_t*>(slot_); }
  std::byte* counts() const { return slot_ + kCellVoxels * sizeof(std::int16_t); }
  std::uint16_t count(int i) const {
    return count_bytes_ == 1 ? reinterpret_cast<const std::uint8_t*>(counts())[i]
                             : reinterpret_cast<const std::uint16_t*>(counts())[i];
  }
  void set_count(int i, std::uint16_t count) const {
    if (count_bytes_ == 1) {
      reinterpret_cast<std::uint8_t*>(counts())[i] = static_cast<std::uint8_t>(count);
    } else {
      reinterpret_cast<std::uint16_t*>(counts())[i] = count;
    }
  }
  static constexpr std::size_t bytes(int count_bytes) {
    return kCellVoxels * (sizeof(std::int16_t) + static_cast<std::size_t>(count_bytes));
  }

 private:
  std::byte* slot_;
  int count_bytes_;
};

/// Slots have numbers. Several threads may read and write slots of their own at once, and take and
/// give back slots through a Cache each, after reserve().
class CellPool {
 public:
  explicit CellPool(int count_bytes)
      : count_bytes_(count_bytes), slot_bytes_(CellVoxels::bytes(count_bytes)) {}
  CellPool(CellPool&& other) noexcept { swap(other); }
  CellPool& operator=(CellPool&& other) noexcept {
    CellPool taken(std::move(other));
    swap(taken);
    return *this;
  }
  void swap(CellPool& other) noexcept;

  CellVoxels operator[](std::uint32_t slot) const {
    return {chunks_[slot / kChunk].get() + slot % kChunk * slot_bytes_, count_bytes_};
  }

  int count_bytes() const { return count_bytes_; }
  std::size_t in_use() const { return used_ - free_.size(); }
  std::size_t memory_bytes() const;
  bool is_sparse() const { return used_ > 2 * in_use() + kChunk; }

  /// Reserves room for the numbers of `slots` more slots. Threads may take slots concurrently only
  /// after it.
  void reserve(std::size_t slots);

  /// Slots cached by one thread. The destructor returns unused ones to the pool.
  class Cache {
   public:
    explicit Cache(CellPool& pool) : pool_(pool) {}
    ~Cache() { pool_.give_back(slots_); }
    Cache(const Cache&) = delete;
    Cache& operator=(const Cache&) = delete;

    std::uint32_t take() {
      if (slots_.empty()) pool_.take(kAtOnce, slots_);
      const std::uint32_t slot = slots_.back();
      slots_.pop_back();
      return slot;
    }
    void give_back(std::uint32_t slot) { slots_.push_back(slot); }
    CellVoxels operator[](std::uint32_t slot) const { return pool_[slot]; }

   private:
    static constexpr std::size_t kAtOnce = 32;

    CellPool& pool_;
    std::vector<std::uint32_t> slots_;
  };

 private:
  static constexpr std::uint32_t kChunk = 256;

  void take(std::size_t count, std::vector<std::uint32_t>& slots);
  void give_back(std::vector<std::uint32_t>& slots);

  int count_bytes_ = 1;
  std::size_t slot_bytes_ = 0;
  std::mutex mutex_;
  std::vector<std::unique_ptr<std::byte[]>> chunks_;
  std::vector<std::uint32_t> free_;
  std::size_t used_ = 0;  ///< slots that were ever taken
};

}  // namespace mapperd::map
