// An order of points in which those near each other follow one another.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace mapperd::acoustics {

// Spreads the lowest 10 bits to every third one.
inline std::uint32_t spread_bits(std::uint32_t x) {
  x = (x | x << 16) & 0x030000FFU;
  x = (x | x << 8) & 0x0300F00FU;
  x = (x | x << 4) & 0x030C30C3U;
  return (x | x << 2) & 0x09249249U;
}

// Numbers of finite points, (count, 3), along a Morton curve.
inline std::vector<std::uint32_t> morton_order(const float* points, std::size_t count) {
  float low[3] = {1e30F, 1e30F, 1e30F};
  float high[3] = {-1e30F, -1e30F, -1e30F};
  for (std::size_t i = 0; i < 3 * count; ++i) {
    low[i % 3] = std::min(low[i % 3], points[i]);
    high[i % 3] = std::max(high[i % 3], points[i]);
  }
  const float wide = std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2], 1e-9F});
  std::vector<std::pair<std::uint32_t, std::uint32_t>> codes;
  codes.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    std::uint32_t code = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const float at = (points[3 * i + k] - low[k]) / wide * 1023.0F;
      code |= spread_bits(static_cast<std::uint32_t>(at)) << k;
    }
    codes.emplace_back(code, static_cast<std::uint32_t>(i));
  }
  std::sort(codes.begin(), codes.end());
  std::vector<std::uint32_t> order;
  order.reserve(count);
  for (const auto& at : codes) order.push_back(at.second);
  return order;
}

}  // namespace mapperd::acoustics
