#include <algorithm>
#include <cmath>
#include <vector>

#include "mapperd/acoustics/cells.hpp"
#include "mapperd/acoustics/complex_gaussian.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr std::size_t kRows = 37;
constexpr std::size_t kColumns = 301;

std::vector<float> noise(unsigned threads, std::uint64_t key = 11) {
  std::vector<float> field(2 * kRows * kColumns, 0.0F);
  std::vector<float> row(kRows, 1.0F);
  std::vector<float> column(kColumns, 1.0F);
  for (std::size_t i = 0; i < kRows; ++i) row[i] = static_cast<float>(i);
  column[7] = 0.0F;
  acoustics::add_gaussian(field.data(), kRows, kColumns, {row.data(), column.data()}, key, threads);
  return field;
}

double mean_power(const std::vector<float>& field, std::size_t row) {
  double sum = 0.0;
  for (std::size_t i = 0; i < 2 * kColumns; ++i) {
    const double part = static_cast<double>(field[2 * row * kColumns + i]);
    sum += part * part;
  }
  return sum / static_cast<double>(kColumns);
}

TEST_CASE("noise is the same for any number of threads") {
  const std::vector<float> alone = noise(1);
  for (const unsigned threads : {0U, 2U, 3U, 64U}) CHECK(noise(threads) == alone);
}

TEST_CASE("another key gives other noise") { CHECK(noise(2, 12) != noise(2, 11)); }

TEST_CASE("noise has its row's level and obeys its column's factor") {
  const std::vector<float> field = noise(2);
  CHECK(mean_power(field, 0) == 0.0);
  for (std::size_t row = 1; row < kRows; ++row) {
    const double expected = static_cast<double>(row * row);
    CHECK(mean_power(field, row) / expected == near(1.0, 0.25));
    CHECK(field[2 * (row * kColumns + 7)] == 0.0F);
  }
}

TEST_CASE("extra power is drawn together with that of rows and columns") {
  std::vector<float> row(kRows), column(kColumns), of_rows(kRows), power(kRows * kColumns);
  for (std::size_t i = 0; i < kRows; ++i) row[i] = 0.1F * static_cast<float>(i % 3);
  for (std::size_t i = 0; i < kColumns; ++i) column[i] = static_cast<float>(i % 5);
  for (std::size_t i = 0; i < kRows; ++i) of_rows[i] = static_cast<float>(i);
  for (std::size_t i = 0; i < power.size(); ++i) power[i] = static_cast<float>(i % 7);
  std::vector<float> unit(2 * kRows * kColumns);
  acoustics::complex_gaussians(3, 0, kRows * kColumns, unit.data());
  for (const bool alike : {false, true}) {
    std::vector<float> field(unit.size(), 0.0F);
    acoustics::add_gaussian(field.data(), kRows, kColumns,
                            {row.data(), column.data(), alike ? of_rows.data() : power.data(),
                             alike ? std::size_t{1} : kColumns},
                            3, 2);
    for (std::size_t i = 0; i < field.size() / 2; ++i) {
      const double own = static_cast<double>(row[i / kColumns] * column[i % kColumns]);
      const double extra = static_cast<double>(alike ? of_rows[i / kColumns] : power[i]);
      const double rms = std::sqrt(own * own + extra);
      CHECK(static_cast<double>(field[2 * i + 1]) ==
            near(rms * static_cast<double>(unit[2 * i + 1]), 1e-5));
    }
  }
}

TEST_CASE("a product with weights that begin and end with zeros is the whole one") {
  constexpr std::size_t kOut = 23;
  std::vector<double> power(kRows * 5), weights(5 * kOut, 0.0);
  for (std::size_t i = 0; i < power.size(); ++i) power[i] = std::sin(static_cast<double>(i));
  // The last row is empty, the one before has a zero in the middle.
  for (std::size_t i = 0; i < 4 * kOut; ++i) {
    if (i % 7 > 1) weights[i] = std::cos(static_cast<double>(i));
  }
  const std::vector<float> narrow_power(power.begin(), power.end());
  const std::vector<float> narrow_weights(weights.begin(), weights.end());
  std::vector<double> product(kRows * kOut, 9.0);
  std::vector<float> narrow(kRows * kOut, 9.0F);
  for (const unsigned threads : {1U, 3U}) {
    acoustics::spread_columns(power.data(), kRows, 5, weights.data(), kOut, product.data(),
                              threads);
    acoustics::spread_columns(narrow_power.data(), kRows, 5, narrow_weights.data(), kOut,
                              narrow.data(), threads);
    for (std::size_t row = 0; row < kRows; ++row) {
      for (std::size_t column = 0; column < kOut; ++column) {
        double expected = 0.0;
        for (std::size_t k = 0; k < 5; ++k) {
          expected += power[row * 5 + k] * weights[k * kOut + column];
        }
        CHECK(product[row * kOut + column] == doctest::Approx(expected));
        CHECK(static_cast<double>(narrow[row * kOut + column]) == near(expected, 1e-5));
      }
    }
  }
}

TEST_CASE("noise is added to what is there") {
  std::vector<float> field(2 * kRows * kColumns, 5.0F);
  const std::vector<float> row(kRows, 2.0F);
  const std::vector<float> column(kColumns, 0.5F);
  acoustics::add_gaussian(field.data(), kRows, kColumns, {row.data(), column.data()}, 3, 2);
  std::vector<float> unit(2 * kRows * kColumns);
  acoustics::complex_gaussians(3, 0, kRows * kColumns, unit.data());
  for (std::size_t i = 0; i < field.size(); ++i) CHECK(field[i] == 5.0F + unit[i]);
}

TEST_CASE("each cell's power may be its own, and less than nothing is nothing") {
  std::vector<float> field(2 * kRows * kColumns, 0.0F);
  std::vector<float> power(kRows * kColumns, 4.0F);
  power[3] = -1.0F;
  power[4] = 0.0F;
  acoustics::add_gaussian_power(field.data(), kRows, kColumns, power.data(), {kColumns, 0.0, 1.0},
                                3, 2);
  std::vector<float> unit(2 * kRows * kColumns);
  acoustics::complex_gaussians(3, 0, kRows * kColumns, unit.data());
  CHECK((field[6] == 0.0F && field[8] == 0.0F));
  for (std::size_t i = 10; i < field.size(); ++i) CHECK(field[i] == 2.0F * unit[i]);
}

TEST_CASE("powers on coarse columns are linear between them and constant beyond") {
  const acoustics::CoarseColumns coarse{5, 40.5, 50.0};
  std::vector<float> power;
  std::vector<float> between;
  for (std::size_t row = 0; row < kRows; ++row) {
    for (std::size_t k = 0; k < coarse.count; ++k) {
      power.push_back(static_cast<float>(row + 1) * (k % 2 == 0 ? 4.0F : 9.0F));
    }
    for (std::size_t i = 0; i < kColumns; ++i) {
      const double at = std::min(std::max((static_cast<double>(i) - 40.5) / 50.0, 0.0), 4.0);
      const double away = std::fabs(at - 2.0 * std::round(at / 2.0));
      between.push_back(static_cast<float>(row + 1) * static_cast<float>(4.0 + 5.0 * away));
    }
  }
  std::vector<float> field(2 * kRows * kColumns, 0.0F);
  std::vector<float> expected = field;
  acoustics::add_gaussian_power(field.data(), kRows, kColumns, power.data(), coarse, 3, 2);
  acoustics::add_gaussian_power(expected.data(), kRows, kColumns, between.data(),
                                {kColumns, 0.0, 1.0}, 3, 2);
  double worst = 0.0;
  for (std::size_t i = 0; i < field.size(); ++i) {
    worst = std::max(worst, std::fabs(static_cast<double>(field[i] - expected[i])));
  }
  CHECK(worst < 1e-4);
}

TEST_CASE("blocks have the mean power of their columns, the last of fewer") {
  std::vector<float> cells;
  for (int i = 0; i < 2 * 10; ++i) {
    cells.insert(cells.end(), {static_cast<float>(i % 10), 1.0F});
  }
  std::vector<float> blocks(2 * 3);
  acoustics::block_powers(cells.data(), 2, 2, 10, 4, blocks.data(), 2);
  const std::vector<float> expected{14.0F / 4 + 1, 126.0F / 4 + 1, 145.0F / 2 + 1};
  for (std::size_t i = 0; i < 6; ++i) CHECK(blocks[i] == expected[i % 3]);
  acoustics::block_powers(cells.data(), 1, 2, 20, 20, blocks.data(), 1);
  CHECK(blocks[0] == (45.0F + 10.0F) / 20);
}

TEST_CASE("a cloud fills the rows between entry and exit in parts of a row, and fades") {
  const std::vector<double> enter{1.25, 0.0, 9.0}, leave{3.5, 100.0, 12.0};
  const std::vector<double> weight{2.0, 1.0, 5.0};
  const std::vector<std::int32_t> column{0, 1, 1};
  const std::vector<double> fade_row{4.0, 0.5, 0.25, 0.125, 0.125}, fade_column{1.0, 2.0};
  const std::vector<double> level{1.0, 1.0, 1.0, 1.0, 3.0};
  std::vector<float> power(5 * 2, 10.0F);
  acoustics::add_cloud(power.data(), 5, 2,
                       {3, enter.data(), leave.data(), column.data(), weight.data()},
                       {fade_row.data(), fade_column.data(), level.data()});
  const std::vector<float> expected{10.0F, 11.0F,   10.75F, 11.0F, 10.5F,
                                    10.5F, 10.125F, 10.25F, 10.0F, 10.75F};
  CHECK(power == expected);
}

TEST_CASE("rays are inside a box between its faces, and no farther than they reach") {
  const double low[3] = {1.0, -1.0, -1.0}, high[3] = {3.0, 1.0, 1.0};
  const float half = std::sqrt(0.5F);
  const std::vector<float> rays{1, 0, 0, 1, 0, 0, 1, 0, 0, -1, 0, 0, half, half, 0, 0, 1, 0};
  const std::vector<double> reach{10.0, 2.5, 0.5, 10.0, 10.0, 10.0};
  const double root = std::sqrt(2.0);
  const std::vector<double> from{1.0, 1.0, 0.5, 0.0, root, 0.0};
  const std::vector<double> to{3.0, 2.5, 0.5, 0.0, root, 0.0};
  std::vector<double> enter(6), leave(6);
  acoustics::box_crossing(low, high, 6, rays.data(), reach.data(), enter.data(), leave.data());
  for (std::size_t i = 0; i < 6; ++i) {
    CAPTURE(i);
    CHECK(enter[i] <= leave[i]);
    CHECK(leave[i] - enter[i] == doctest::Approx(to[i] - from[i]).epsilon(1e-6));
    if (to[i] > from[i]) CHECK(enter[i] == doctest::Approx(from[i]));
  }
  // Along its low face a ray is inside, along its high one it is not.
  std::vector<float> along;
  for (int i = 0; i < 16; ++i) along.insert(along.end(), {1.0F, i % 2 == 0 ? 0.0F : -0.0F, 0.0F});
  std::vector<double> far(16, 10.0), begin(16), end(16);
  const double on_low[3] = {1.0, 0.0, -1.0}, on_high[3] = {3.0, 0.0, 1.0};
  const double beyond[3] = {3.0, 2.0, 1.0}, before[3] = {1.0, -2.0, -1.0};
  acoustics::box_crossing(on_low, beyond, 16, along.data(), far.data(), begin.data(), end.data());
  CHECK(begin == std::vector<double>(16, 1.0));
  CHECK(end == std::vector<double>(16, 3.0));
  acoustics::box_crossing(before, on_high, 16, along.data(), far.data(), begin.data(), end.data());
  CHECK(begin == end);
  // From within it begins at once.
  const double around[3] = {-1.0, 0.0, -2.0}, about[3] = {2.0, 1.0, 2.0};
  acoustics::box_crossing(around, about, 1, rays.data(), reach.data(), enter.data(), leave.data());
  CHECK(enter[0] == 0.0);
  CHECK(leave[0] == doctest::Approx(2.0));
}

}  // namespace
