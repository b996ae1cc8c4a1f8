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
  acoustics::add_gaussian(field.data(), kRows, kColumns, row.data(), column.data(), key, threads);
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

TEST_CASE("noise is added to what is there") {
  std::vector<float> field(2 * kRows * kColumns, 5.0F);
  const std::vector<float> row(kRows, 2.0F);
  const std::vector<float> column(kColumns, 0.5F);
  acoustics::add_gaussian(field.data(), kRows, kColumns, row.data(), column.data(), 3, 2);
  std::vector<float> unit(2 * kRows * kColumns);
  acoustics::complex_gaussians(3, 0, kRows * kColumns, unit.data());
  for (std::size_t i = 0; i < field.size(); ++i) CHECK(field[i] == 5.0F + unit[i]);
}

TEST_CASE("each cell's power may be its own, and less than nothing is nothing") {
  std::vector<float> field(2 * kRows * kColumns, 0.0F);
  std::vector<float> power(kRows * kColumns, 4.0F);
  power[3] = -1.0F;
  power[4] = 0.0F;
  acoustics::add_gaussian_power(field.data(), kRows, kColumns, power.data(), 3, 2);
  std::vector<float> unit(2 * kRows * kColumns);
  acoustics::complex_gaussians(3, 0, kRows * kColumns, unit.data());
  CHECK((field[6] == 0.0F && field[8] == 0.0F));
  for (std::size_t i = 10; i < field.size(); ++i) CHECK(field[i] == 2.0F * unit[i]);
}

}  // namespace
