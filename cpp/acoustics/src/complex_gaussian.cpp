#include "mapperd/acoustics/complex_gaussian.hpp"

#include <algorithm>

namespace mapperd::acoustics {

MAPPERD_VECTORISED void complex_gaussians(std::uint64_t key, std::uint64_t first, std::size_t count,
                                          float* out) {
  constexpr std::size_t kBlock = 256;
  const std::uint64_t stream = mix(key);
  std::uint32_t upper[kBlock];
  std::uint32_t lower[kBlock];
  for (std::size_t start = 0; start < count; start += kBlock) {
    const std::size_t block = std::min(kBlock, count - start);
    // The multiplications of 64 bits apart from the rest, which is of 32.
    for (std::size_t i = 0; i < block; ++i) {
      const std::uint64_t bits = mix(stream + first + start + i);
      upper[i] = static_cast<std::uint32_t>(bits >> 32);
      lower[i] = static_cast<std::uint32_t>(bits);
    }
    float* to = out + 2 * start;
    for (std::size_t i = 0; i < block; ++i) {
      const Gaussian number = gaussian_of(upper[i], lower[i]);
      to[2 * i] = number.re;
      to[2 * i + 1] = number.im;
    }
  }
}

}  // namespace mapperd::acoustics
