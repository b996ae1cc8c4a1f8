#include <cmath>

#include "mapperd/localization/draws.hpp"
#include "testing.hpp"

namespace {

using namespace mapperd;
using namespace mapperd::localization;

TEST_CASE("normal numbers have the moments of normal numbers, whatever their block") {
  double sum[5] = {};
  NormalBlock block;
  NormalBlock one;
  const std::size_t blocks = 4000;
  for (std::size_t b = 0; b < blocks; ++b) {
    draw_normals({7, 3}, Purpose::kMotion, b * kBlock, kBlock, block);
    draw_normals({7, 3}, Purpose::kMotion, b * kBlock + 5, 1, one);
    CHECK(one.number[2][0] == block.number[2][5]);
    for (const auto& row : block.number) {
      for (const double z : row) {
        sum[1] += z;
        sum[2] += z * z;
        sum[3] += z * z * z;
        sum[4] += z * z * z * z;
      }
    }
  }
  const double count = static_cast<double>(4 * blocks * kBlock);
  CHECK(sum[1] / count == near(0.0, 4.0 / std::sqrt(count)));
  CHECK(sum[2] / count == near(1.0, 4.0 * std::sqrt(2.0 / count)));
  CHECK(sum[3] / count == near(0.0, 4.0 * std::sqrt(15.0 / count)));
  CHECK(sum[4] / count == near(3.0, 4.0 * std::sqrt(96.0 / count)));
}

}  // namespace
