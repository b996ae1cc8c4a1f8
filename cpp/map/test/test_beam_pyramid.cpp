// What the pyramids say of a run of beams is what a loop over them says.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "check.hpp"
#include "mapperd/map/beam_pyramid.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::ReturnRows;

TEST_CASE("the extreme of every run of beams") {
  scenes::Random random(51);
  for (const std::size_t beams : {1U, 2U, 3U, 4U, 5U, 7U, 8U, 9U, 31U, 32U, 33U, 100U}) {
    std::vector<double> values(beams);
    for (double& value : values) value = random.uniform(-9, 9);
    const mapperd::map::RunExtreme<mapperd::map::Smaller> least(values);
    const mapperd::map::RunExtreme<mapperd::map::Larger> most(values);
    for (std::size_t first = 0; first < beams; ++first) {
      for (std::size_t last = first; last < beams; ++last) {
        const auto begin = values.begin() + static_cast<std::ptrdiff_t>(first);
        const auto end = values.begin() + static_cast<std::ptrdiff_t>(last) + 1;
        CHECK(least.of(first, last) == *std::min_element(begin, end));
        CHECK(most.of(first, last) == *std::max_element(begin, end));
      }
    }
  }
}

// The same, a flag a row and beam.
struct Flags {
  Flags(std::size_t beam_count, std::size_t row_count, double share, scenes::Random& random)
      : beams(beam_count), rows(row_count), set(beams * rows), packed(beams, rows) {
    for (std::size_t i = 0; i < set.size(); ++i) {
      if (random.uniform(0, 1) >= share) continue;
      set[i] = true;
      packed.mark(i / rows, i % rows);
    }
    packed.build();
  }

  bool any(std::size_t first, std::size_t last, std::size_t from, std::size_t end) const {
    bool found = false;
    for (std::size_t j = first; j <= last; ++j) {
      for (std::size_t k = from; k < end; ++k) found = found || set[j * rows + k];
    }
    return found;
  }
  std::uint64_t rows_of(std::size_t beam, std::size_t from, std::size_t end) const {
    std::uint64_t bits = 0;
    for (std::size_t k = from; k < end; ++k) {
      if (set[beam * rows + k]) bits |= std::uint64_t{1} << (k - from);
    }
    return bits;
  }

  std::size_t beams;
  std::size_t rows;
  std::vector<bool> set;
  ReturnRows packed;
};

void check_rows(const Flags& flags) {
  for (std::size_t j = 0; j < flags.beams; ++j) {
    std::size_t expected = flags.rows;
    for (std::size_t k = flags.rows; k-- > 0;) {
      if (flags.set[j * flags.rows + k]) expected = k;
      const std::size_t found = flags.packed.next(j, k);
      CHECK(expected == flags.rows ? found >= flags.rows : found == expected);
    }
    CHECK(flags.packed.next(j, flags.rows) >= flags.rows);
    for (std::size_t from = 0; from < flags.rows; ++from) {
      for (std::size_t end = from; end <= std::min(from + 64, flags.rows); ++end) {
        CHECK(flags.packed.rows_of(j, from, end) == flags.rows_of(j, from, end));
      }
    }
  }
}

void check_runs(const Flags& flags, scenes::Random& random) {
  const auto pick = [&random](std::size_t low, std::size_t high) {
    return static_cast<std::size_t>(random.integer(static_cast<int>(low), static_cast<int>(high)));
  };
  for (std::size_t first = 0; first < flags.beams; ++first) {
    for (std::size_t last = first; last < flags.beams; ++last) {
      for (int i = 0; i < 8; ++i) {
        const std::size_t from = pick(0, flags.rows - 1);
        const std::size_t end = pick(from, std::min(flags.rows, i < 4 ? from + 3 : flags.rows));
        CHECK(flags.packed.any(first, last, from, end) == flags.any(first, last, from, end));
      }
    }
  }
}

TEST_CASE("returns in any rows of any run of beams") {
  scenes::Random random(52);
  for (const std::size_t rows : {1U, 63U, 64U, 65U, 127U, 128U, 129U, 200U}) {
    for (const std::size_t beams : {1U, 2U, 5U, 17U}) {
      for (const double share : {0.005, 0.1}) {
        const Flags flags(beams, rows, share, random);
        check_rows(flags);
        check_runs(flags, random);
      }
    }
  }
}

TEST_CASE("a single return at a word's border is found from all sides, and only there") {
  for (const std::size_t row : {0U, 1U, 62U, 63U, 64U, 65U, 126U, 127U, 128U, 129U}) {
    for (const std::size_t beam : {0U, 3U, 6U}) {
      ReturnRows rows(7, 130);
      rows.mark(beam, row);
      rows.build();
      for (std::size_t from = 0; from < 130; ++from) {
        for (std::size_t end = from; end <= 130; ++end) {
          CHECK(rows.any(0, 6, from, end) == (from <= row && row < end));
          CHECK(rows.any(beam, beam, from, end) == (from <= row && row < end));
          CHECK(beam == 6 || !rows.any(beam + 1, 6, from, end));
          CHECK(beam == 0 || !rows.any(0, beam - 1, from, end));
        }
      }
    }
  }
}

}  // namespace
