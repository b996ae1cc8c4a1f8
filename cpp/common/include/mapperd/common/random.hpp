/// \file
/// \brief Random numbers as functions of a key, independent of order and thread.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstdint>

#include "mapperd/common/simd.hpp"

namespace mapperd {

/// Returns 64 well-mixed bits of a key (the finaliser of SplitMix64, Steele, Lea and Flood 2014).
MAPPERD_INLINE std::uint64_t mix(std::uint64_t key) {
  key += 0x9E3779B97F4A7C15ULL;
  key = (key ^ (key >> 30)) * 0xBF58476D1CE4E5B9ULL;
  key = (key ^ (key >> 27)) * 0x94D049BB133111EBULL;
  return key ^ (key >> 31);
}

/// Combines two keys into one; their order matters.
MAPPERD_INLINE std::uint64_t joined(std::uint64_t first, std::uint64_t second) {
  return mix(mix(first) ^ second);
}

/// Four random words, 128 bits.
struct Words {
  std::uint32_t word[4];
};

/// Philox4x32 with ten rounds (Salmon, Moraes, Dror and Shaw 2011).
MAPPERD_INLINE Words philox(Words counter, std::uint64_t key) {
  auto low = static_cast<std::uint32_t>(key);
  auto high = static_cast<std::uint32_t>(key >> 32);
  Words c = counter;
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t first = std::uint64_t{0xD2511F53U} * c.word[0];
    const std::uint64_t second = std::uint64_t{0xCD9E8D57U} * c.word[2];
    c = {{static_cast<std::uint32_t>(second >> 32) ^ c.word[1] ^ low,
          static_cast<std::uint32_t>(second),
          static_cast<std::uint32_t>(first >> 32) ^ c.word[3] ^ high,
          static_cast<std::uint32_t>(first)}};
    low += 0x9E3779B9U;
    high += 0xBB67AE85U;
  }
  return c;
}

/// Uniform in (0, 1), with 32 bits.
MAPPERD_INLINE double uniform_of(std::uint32_t word) {
  return (static_cast<double>(word) + 0.5) * 0x1p-32;
}

/// Uniform in [0, 1), with 53 bits.
MAPPERD_INLINE double uniform_of(std::uint32_t high, std::uint32_t low) {
  const std::uint64_t bits = (static_cast<std::uint64_t>(high) << 32) | low;
  return static_cast<double>(bits >> 11) * 0x1p-53;
}

}  // namespace mapperd
