// The distance transform against the distance to every marked cell.
#include <algorithm>

#include "mapperd/localization/distance_transform.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace mapperd;
using namespace mapperd::localization;

std::int32_t nearest(const std::vector<std::uint8_t>& marked, int columns, int row, int column,
                     int limit) {
  std::int32_t best = kBeyond;
  for (int i = 0; i < static_cast<int>(marked.size()); ++i) {
    if (marked[static_cast<std::size_t>(i)] == 0) continue;
    const int dr = i / columns - row;
    const int dc = i % columns - column;
    best = std::min(best, dr * dr + dc * dc);
  }
  return best <= limit * limit ? best : kBeyond;
}

void compare(std::size_t rows, std::size_t columns, double share, std::int32_t limit) {
  const auto grid = scenes::scattered(rows, columns, rows * 31 + columns, share);
  std::vector<std::uint8_t> marked;
  for (const auto cell : grid.cells) marked.push_back(cell == kOccupied ? 1 : 0);
  const auto found = squared_distances(marked, rows, columns, limit, 1);
  CHECK(found == squared_distances(marked, rows, columns, limit, 3));
  for (int r = 0; r < static_cast<int>(rows); ++r) {
    for (int c = 0; c < static_cast<int>(columns); ++c) {
      const auto at = static_cast<std::size_t>(r) * columns + static_cast<std::size_t>(c);
      CHECK(found[at] == nearest(marked, static_cast<int>(columns), r, c, limit));
    }
  }
}

TEST_CASE("every squared distance is the one to the nearest marked cell") {
  for (const double share : {0.0, 0.001, 0.01, 0.1, 0.6, 1.0}) {
    compare(40, 70, share, 10000);
    compare(70, 33, share, 9);
    compare(1, 50, share, 7);
    compare(50, 1, share, 10000);
    compare(1, 1, share, 3);
  }
}

TEST_CASE("the largest grid's distances fit") {
  std::vector<std::uint8_t> marked(2 * kMaxGridSide, 0);
  marked[0] = 1;
  const auto wide = squared_distances(marked, 2, kMaxGridSide, 1 << 19, 1);
  const auto tall = squared_distances(marked, kMaxGridSide, 2, 1 << 19, 1);
  const std::int32_t far = 31999 * 31999 + 1;
  CHECK(wide.back() == far);
  CHECK(tall.back() == far);
}

}  // namespace
