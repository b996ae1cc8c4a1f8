#include <algorithm>
#include <cmath>
#include <vector>

#include "mapperd/acoustics/beams.hpp"
#include "mapperd/acoustics/complex_gaussian.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

using acoustics::CellGrid;
using acoustics::Response;

std::vector<float> random_numbers(std::size_t count, std::uint64_t key) {
  std::vector<float> numbers(2 * count);
  acoustics::complex_gaussians(key, 0, count, numbers.data());
  numbers.resize(count);
  return numbers;
}

struct Setup {
  std::size_t rows, columns, parts, taps, range_taps, first, beams;
};

// The sums as they are written down.
std::vector<double> brute_force(const Setup& s, const std::vector<float>& cells,
                                const std::vector<float>& taps, const std::vector<float>& range) {
  std::vector<double> out(s.rows * s.beams * s.parts, 0.0);
  const auto reach = static_cast<long>(s.taps / 2);
  const auto deep = static_cast<long>(s.range_taps / 2);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const std::size_t part = i % s.parts;
    const auto beam = static_cast<long>(i / s.parts % s.beams);
    const auto row = static_cast<long>(i / s.parts / s.beams);
    for (long r = -deep; r <= deep; ++r) {
      if (row + r < 0 || row + r >= static_cast<long>(s.rows)) continue;
      for (long k = -reach; k <= reach; ++k) {
        const long column = static_cast<long>(s.first) + beam + k;
        if (column < 0 || column >= static_cast<long>(s.columns)) continue;
        const std::size_t cell =
            static_cast<std::size_t>(row + r) * s.columns + static_cast<std::size_t>(column);
        out[i] += static_cast<double>(range[static_cast<std::size_t>(r + deep)]) *
                  static_cast<double>(taps[static_cast<std::size_t>(k + reach)]) *
                  static_cast<double>(cells[cell * s.parts + part]);
      }
    }
  }
  return out;
}

void compare(const Setup& s, unsigned threads) {
  const std::vector<float> cells = random_numbers(s.rows * s.columns * s.parts, 1);
  const std::vector<float> taps = random_numbers(s.taps, 2);
  const std::vector<float> range = random_numbers(s.range_taps, 3);
  std::vector<float> out(s.rows * s.beams * s.parts, -7.0F);
  const CellGrid grid{cells.data(), s.rows, s.columns, s.parts};
  const Response response{taps.data(), s.taps, range.data(), s.range_taps};
  acoustics::form_beams(grid, response, s.first, s.beams, out.data(), threads);
  const std::vector<double> expected = brute_force(s, cells, taps, range);
  double worst = 0.0;
  for (std::size_t i = 0; i < out.size(); ++i) {
    worst = std::max(worst, std::abs(static_cast<double>(out[i]) - expected[i]));
  }
  CHECK(worst < 1e-5 * static_cast<double>(s.taps));
}

TEST_CASE("few taps give the sums as they are written down") {
  compare({5, 40, 2, 15, 3, 4, 32}, 2);
  compare({5, 40, 1, 15, 5, 4, 32}, 2);
  compare({1, 9, 2, 1, 1, 0, 9}, 1);
  compare({4, 6, 2, 13, 3, 2, 3}, 3);  // the taps reach past the columns
}

TEST_CASE("many taps give the same sums by transform, of all lengths") {
  for (const std::size_t columns : {9UL, 60UL, 100UL, 140UL}) {
    const std::size_t first = columns / 10;
    const std::size_t beams = columns - 2 * first;
    for (const std::size_t taps : {65UL, 99UL, 401UL}) {
      for (const std::size_t parts : {1UL, 2UL}) {
        compare({21, columns, parts, taps, 3, first, beams}, 2);
      }
    }
  }
}

TEST_CASE("beams beyond the last column hear silence") {
  compare({3, 20, 2, 15, 1, 10, 30}, 1);
  compare({3, 20, 2, 65, 1, 10, 30}, 1);
  compare({3, 20, 1, 65, 1, 25, 30}, 1);
}

TEST_CASE("beams are the same for any number of threads") {
  const std::vector<float> range{0.25F, 1.0F, 0.25F};
  for (const std::size_t parts : {1UL, 2UL}) {
    const std::vector<float> cells = random_numbers(51 * 80 * parts, 1);
    for (const std::size_t count : {9UL, 81UL}) {
      const std::vector<float> taps = random_numbers(count, 2);
      const Response response{taps.data(), count, range.data(), 3};
      std::vector<float> alone(51 * 60 * parts);
      acoustics::form_beams({cells.data(), 51, 80, parts}, response, 10, 60, alone.data(), 1);
      for (const unsigned threads : {2U, 3U, 7U}) {
        std::vector<float> out(51 * 60 * parts);
        acoustics::form_beams({cells.data(), 51, 80, parts}, response, 10, 60, out.data(), threads);
        CHECK(out == alone);
      }
    }
  }
}

TEST_CASE("a loud row leaves nothing in rows far from it") {
  const std::vector<float> taps(81, 1.0F), range{1.0F};
  for (const std::size_t parts : {1UL, 2UL}) {
    std::vector<float> cells(33 * 80 * parts, 1.0F);
    const auto loud = cells.begin() + static_cast<std::ptrdiff_t>(17 * 80 * parts);
    std::fill(loud, loud + static_cast<std::ptrdiff_t>(80 * parts), 1e12F);
    std::vector<float> out(33 * 2 * parts);
    acoustics::form_beams({cells.data(), 33, 80, parts}, {taps.data(), 81, range.data(), 1}, 39, 2,
                          out.data(), 1);
    for (std::size_t i = 0; i < out.size(); ++i) {
      const std::size_t row = i / (2 * parts);
      CAPTURE(row);
      if (row != 16 && row != 17) CHECK(static_cast<double>(out[i]) == near(80.0, 1e-3));
    }
  }
}

TEST_CASE("beams anywhere with the pitch's own places are those of the pitch") {
  const std::vector<float> cells = random_numbers(6 * 40 * 2, 1);
  const std::vector<float> taps = random_numbers(15, 2);
  const std::vector<float> range{0.25F, 1.0F, 0.25F};
  const CellGrid grid{cells.data(), 6, 40, 2};
  std::vector<float> expected(6 * 32 * 2);
  acoustics::form_beams(grid, {taps.data(), 15, range.data(), 3}, 4, 32, expected.data(), 1);
  std::vector<float> repeated;
  std::vector<std::int64_t> firsts;
  for (std::int64_t beam = 0; beam < 32; ++beam) {
    repeated.insert(repeated.end(), taps.begin(), taps.end());
    firsts.push_back(beam + 4 - 7);
  }
  std::vector<float> out(6 * 32 * 2);
  acoustics::form_beams_at(grid, {repeated.data(), 15, range.data(), 3}, firsts.data(), 32,
                           out.data(), 2);
  for (std::size_t i = 0; i < out.size(); ++i) {
    CHECK(static_cast<double>(out[i]) == near(static_cast<double>(expected[i]), 1e-5));
  }
}

}  // namespace
