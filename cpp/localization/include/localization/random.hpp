// Random numbers that belong to a key: the same whatever the order or the thread that asks.
#pragma once

#include <cstddef>
#include <cstdint>

#include "localization/vectorised.hpp"

namespace mapperd::localization {

// What a draw is for; a part of its key.
enum class Purpose : std::uint32_t { kMotion, kFloor, kStart, kInjection, kResampling };

// The draws of one step of one filter.
struct Stream {
  std::uint64_t seed = 0;
  std::uint64_t step = 0;
};

struct Words {
  std::uint32_t word[4];
};

// Philox4x32 with ten rounds (Salmon, Moraes, Dror and Shaw 2011).
LOCALIZATION_INLINE Words philox(Words counter, std::uint64_t key) {
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

// Four words of a particle.
LOCALIZATION_INLINE Words draw(const Stream& stream, Purpose purpose, std::uint32_t particle) {
  return philox(
      {{particle, static_cast<std::uint32_t>(purpose), static_cast<std::uint32_t>(stream.step),
        static_cast<std::uint32_t>(stream.step >> 32)}},
      stream.seed);
}

// Uniform in (0, 1), with 32 bits.
LOCALIZATION_INLINE double uniform_of(std::uint32_t word) {
  return (static_cast<double>(word) + 0.5) * 0x1p-32;
}

// Uniform in [0, 1), with 53 bits.
LOCALIZATION_INLINE double uniform_of(std::uint32_t high, std::uint32_t low) {
  const std::uint64_t bits = (static_cast<std::uint64_t>(high) << 32) | low;
  return static_cast<double>(bits >> 11) * 0x1p-53;
}

inline constexpr std::size_t kBlock = 64;  // particles worked on at once

// Four standard normal numbers a particle, of particles first ... first + count - 1 (count at most
// kBlock): Box and Muller (1958). Beyond 6.7 none come.
struct NormalBlock {
  double number[4][kBlock];
};
void draw_normals(const Stream& stream, Purpose purpose, std::size_t first, std::size_t count,
                  NormalBlock& out);

}  // namespace mapperd::localization
