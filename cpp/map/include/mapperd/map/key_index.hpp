/// \file
/// \brief Numbers keys in the order in which they come: 0, 1, 2, ...; a number stays with its key.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/common/memory_use.hpp"
#include "mapperd/map/block.hpp"

namespace mapperd::map {

/// Numbers keys in the order of their first use.
class KeyIndex {
 public:
  static constexpr std::uint32_t kNone = 0xFFFFFFFFU;

  std::size_t size() const { return keys_.size(); }
  const BlockKey& operator[](std::size_t number) const { return keys_[number]; }
  std::size_t memory_bytes() const { return allocated_by(keys_) + allocated_by(slots_); }

  std::uint32_t find(const BlockKey& key) const {
    return slots_.empty() ? kNone : slots_[slot_of(key)];
  }

  std::uint32_t find_or_add(const BlockKey& key) {
    if (4 * (keys_.size() + 1) > 3 * slots_.size()) grow();
    const std::size_t slot = slot_of(key);
    if (slots_[slot] == kNone) {
      slots_[slot] = static_cast<std::uint32_t>(keys_.size());
      keys_.push_back(key);
    }
    return slots_[slot];
  }

 private:
  static constexpr std::size_t kFirstSlots = 64;

  /// The constants are those of the MurmurHash3 finaliser.
  static std::uint64_t hash_of(const BlockKey& key) {
    const auto mix = [](std::uint64_t h) {
      h = (h ^ (h >> 33U)) * 0xff51afd7ed558ccdULL;
      h = (h ^ (h >> 33U)) * 0xc4ceb9fe1a85ec53ULL;
      return h ^ (h >> 33U);
    };
    const auto word = [](std::int32_t i) { return std::uint64_t{static_cast<std::uint32_t>(i)}; };
    return mix(mix((word(key.x) << 32U) | word(key.y)) + word(key.z));
  }

  std::size_t slot_of(const BlockKey& key) const {
    const std::size_t mask = slots_.size() - 1;
    std::size_t slot = hash_of(key) & mask;
    while (slots_[slot] != kNone && !(keys_[slots_[slot]] == key)) slot = (slot + 1) & mask;
    return slot;
  }

  void grow() {
    slots_.assign(slots_.empty() ? kFirstSlots : 2 * slots_.size(), kNone);
    for (std::size_t i = 0; i < keys_.size(); ++i) {
      slots_[slot_of(keys_[i])] = static_cast<std::uint32_t>(i);
    }
  }

  std::vector<BlockKey> keys_;
  std::vector<std::uint32_t> slots_;  ///< open addressing, a power of two, at most 3/4 full
};

}  // namespace mapperd::map
