/// \file
/// \brief The particle filter's random numbers: independent of order and thread.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/common/random.hpp"

namespace mapperd::localization {

/// Purpose of a draw, a part of its key.
enum class Purpose : std::uint32_t { kMotion, kFloor, kStart, kInjection, kResampling };

/// The draws of one step of one filter.
struct Stream {
  std::uint64_t seed = 0;
  std::uint64_t step = 0;
};

/// Returns four random words for a particle.
MAPPERD_INLINE Words draw(const Stream& stream, Purpose purpose, std::uint32_t particle) {
  return philox(
      {{particle, static_cast<std::uint32_t>(purpose), static_cast<std::uint32_t>(stream.step),
        static_cast<std::uint32_t>(stream.step >> 32)}},
      stream.seed);
}

inline constexpr std::size_t kBlock = 64;  ///< particles processed together

/// Four standard normal numbers per particle, for particles first ... first + count - 1 (count at
/// most kBlock): Box and Muller (1958). Magnitudes do not exceed 6.7.
struct NormalBlock {
  double number[4][kBlock];
};
void draw_normals(const Stream& stream, Purpose purpose, std::size_t first, std::size_t count,
                  NormalBlock& out);

}  // namespace mapperd::localization
