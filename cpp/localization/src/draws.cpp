#include "mapperd/localization/draws.hpp"

#include <cmath>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {

MAPPERD_VECTORISED void draw_normals(const Stream& stream, Purpose purpose, std::size_t first,
                                     std::size_t count, NormalBlock& out) {
  const Stream fixed = stream;
  std::uint32_t words[4][kBlock];
  for (std::size_t i = 0; i < count; ++i) {
    const Words drawn = draw(fixed, purpose, static_cast<std::uint32_t>(first + i));
    for (int k = 0; k < 4; ++k) words[k][i] = drawn.word[k];
  }
  for (int pair = 0; pair < 2; ++pair) {
    const std::uint32_t* levels = words[2 * pair];
    const std::uint32_t* angles = words[2 * pair + 1];
    for (std::size_t i = 0; i < count; ++i) {
      const double radius = std::sqrt(-2.0 * fast_log(uniform_of(levels[i])));
      const SineCosine turn = fast_sine_cosine(2.0 * kPi * uniform_of(angles[i]));
      out.number[2 * pair][i] = radius * turn.cosine;
      out.number[2 * pair + 1][i] = radius * turn.sine;
    }
  }
}

}  // namespace mapperd::localization
