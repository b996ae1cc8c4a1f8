#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "mapperd/acoustics/preview.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

using mapperd::Transform;
using mapperd::Vec3;

TEST_CASE("a patch of a ball has the ball's normal, wherever and however the ball lies") {
  constexpr double kRadiusM = 0.5;
  // A ball about its frame's origin: the normal at p is p over the radius.
  std::vector<double> ball(12, 0.0);
  for (const std::size_t i : {0U, 5U, 10U}) ball[i] = 1.0 / kRadiusM;
  const std::vector<acoustics::Face> faces{{{0.0, 0.0, 1.0, 0.0}, 0.0, 1, 0, -1},
                                           {{1.0, 0.0, 0.0, 0.5}, 2.0, 1, 0, 0}};
  // A quarter turn about z, and an offset; the other group stands in the map.
  std::vector<Transform> map_T_group(2);
  map_T_group[0].rows = {Vec3{0, -1, 0}, Vec3{1, 0, 0}, Vec3{0, 0, 1}};
  map_T_group[0].translation = {2.0, 1.0, 0.0};
  // The sonar looks along y of the map. Past the ball's middle by 0.3 of 0.5: it is met at 0.4
  // before the middle. A level face is seen at an angle of 30 degrees downwards.
  Transform map_T_sonar;
  map_T_sonar.rows = {Vec3{0, -1, 0}, Vec3{1, 0, 0}, Vec3{0, 0, 1}};
  map_T_sonar.translation = {1.7, -3.0, 0.0};
  const double cosine = std::sqrt(0.75);
  const std::vector<double> direction{1, 0, 0, 1, 0, 0, cosine, 0, -0.5, 1, 0, 0};
  const std::vector<double> solid_angle{1e-4, 1e-4, 2e-4, 1e-4};
  const std::vector<std::int32_t> face{1, -1, 0, 1};
  const std::vector<std::int32_t> group{0, 0, 1, 0};
  const std::vector<float> range_m{3.6F, 1.0F, 2.0F, 9.0F};
  std::vector<std::int64_t> ray(4);
  std::vector<double> point(12), normal(12), cosines(4), area(4), extent(4), turn(12);
  const acoustics::CoarseRays rays{
      4,    face.data(), group.data(), range_m.data(), direction.data(), solid_angle.data(),
      0.01, 0.02,        map_T_sonar};
  const std::size_t count =
      acoustics::coarse_patches({faces.data(), ball.data(), nullptr}, rays, 5.0, map_T_group.data(),
                                {ray.data(), point.data(), normal.data(), cosines.data(),
                                 area.data(), extent.data(), turn.data()});
  REQUIRE(count == 2);  // one hit nothing, one lies out of range
  CHECK((ray[0] == 0 && ray[1] == 2));
  const std::vector<double> points{1.7, 0.6, 0.0, 1.7, -3.0 + 2.0 * cosine, -1.0};
  const std::vector<double> normals{-0.6, -0.8, 0.0, 0.0, 0.0, 1.0};
  for (std::size_t i = 0; i < 6; ++i) {
    CHECK(point[i] == near(points[i], 1e-6));
    CHECK(normal[i] == near(normals[i], 1e-6));
  }
  CHECK(cosines[0] == near(0.8, 1e-6));
  CHECK(cosines[1] == near(0.5, 1e-9));
  CHECK(area[0] == near(3.6 * 3.6 * 1e-4 / 0.8, 1e-6));
  CHECK(area[1] == near(4.0 * 2e-4 / 0.5, 1e-9));
  // Across the ball's slope of 0.6 / 0.8; along a floor at height h, R = h / -w.
  CHECK(extent[0] == near(3.6 * 0.01 * 0.6 / 0.8, 1e-6));
  CHECK(extent[1] == near(1.0 / 0.25 * 0.02, 1e-9));
  // Of G, which is 2 times one; its trace counts the third direction too.
  const double variance = 3.6 * 0.02 * 3.6 * 0.02 / 12.0;
  CHECK(turn[0] == near(12.0 * variance, 1e-6));
  CHECK(turn[1] == near(std::pow(12.0 * variance, 2), 1e-6));
  // In the tangent plane the ray keeps 0.6 of its length.
  CHECK(turn[2] == near(4.0 * 0.36 * variance, 1e-6));
  for (std::size_t i = 3; i < 6; ++i) CHECK(turn[i] == 0.0);
}

TEST_CASE("a patch fills the rows that it covers, and at least one") {
  const std::vector<std::int64_t> column{0, 1, 1, 2};
  const std::vector<double> range_m{0.5, 0.2, 0.25, 9.0};
  const std::vector<double> extent_m{0.4, 0.0, 0.02, 0.2};
  const std::vector<double> power{2.0, 3.0, 1.0, 5.0};
  std::vector<double> picture(30);
  acoustics::spread_over_rows({4, column.data(), range_m.data(), extent_m.data(), power.data()},
                              0.1, 10, 3, picture.data());
  std::vector<double> expected(30, 0.0);
  for (const std::size_t row : {3U, 4U, 5U, 6U}) expected[3 * row] = 5.0;
  expected[3 * 2 + 1] = 40.0;
  for (std::size_t i = 0; i < 30; ++i) CHECK(picture[i] == near(expected[i], 1e-9));
}

std::vector<float> noise(std::size_t size, unsigned seed, float highest) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(0.0F, highest);
  std::vector<float> values(size);
  std::generate(values.begin(), values.end(), [&] { return uniform(random); });
  return values;
}

/// By sorting all pixels' differences.
double sorted_change_db(const std::vector<float>& a, const std::vector<float>& b, double gamma,
                        double largest, std::size_t exceeding) {
  std::vector<double> change;
  const double least = std::pow(0.5 / largest, 1.0 / gamma);
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double x = static_cast<double>(a[i]);
    const double y = static_cast<double>(b[i]);
    const double steps = std::fabs(std::pow(x, gamma) - std::pow(y, gamma)) * largest;
    const double ratio = std::max(x, least) / std::max(y, least);
    change.push_back(steps > 1.0 ? std::fabs(20.0 * std::log10(ratio)) : 0.0);
  }
  std::sort(change.rbegin(), change.rend());
  return change[exceeding];
}

TEST_CASE("the difference of pixels is the sorted one") {
  const auto a = noise(40 * 30, 1, 0.2F);
  const auto b = noise(40 * 30, 2, 0.2F);
  for (const float gamma : {1.0F, 127.0F / 255.0F}) {
    for (const std::size_t exceeding : {0U, 1U, 100U, 900U, 1199U}) {
      const acoustics::PicturePair pair{a.data(), b.data(), 40, 30, gamma, 0.0, 0.0};
      CHECK(acoustics::pixel_change_db(pair, 255.0F, exceeding) ==
            near(sorted_change_db(a, b, static_cast<double>(gamma), 255.0, exceeding), 1e-4));
    }
  }
}

TEST_CASE("a whole cell's displacement explains what it moved, along its own axis") {
  // Along the rows a ramp; a cell farther it is one step higher, but for the last row.
  const std::size_t rows = 20;
  const std::size_t columns = 7;
  std::vector<float> ramp(rows * columns);
  std::vector<float> moved(rows * columns);
  for (std::size_t i = 0; i < ramp.size(); ++i) {
    const std::size_t row = i / columns;
    ramp[i] = 0.1F + 0.02F * static_cast<float>(row);
    moved[i] = 0.1F + 0.02F * static_cast<float>(std::min(row + 1, rows - 1));
  }
  const auto change_db = [&](double row_cells, double column_cells) {
    return acoustics::pixel_change_db(
        {ramp.data(), moved.data(), rows, columns, 1.0F, row_cells, column_cells}, 65535.0F, 0);
  };
  CHECK(change_db(1.0, 0.0) < 1e-3);
  CHECK(change_db(0.5, 0.0) > 0.5);
  CHECK(change_db(0.0, 1.0) == near(20.0 * std::log10(0.12 / 0.1), 1e-3));
  CHECK(change_db(1e9, 0.0) < 1e-3);
}

TEST_CASE("dark pixels differ by their means, where enough of a band is dark") {
  // The mean pixel is the amplitude in steps, up to two of them.
  std::vector<float> table(201);
  for (std::size_t i = 0; i < 200; ++i) table[i] = static_cast<float>(i) / 100.0F;
  const acoustics::DarkPixels dark{table.data(), 200, 2.0F};
  std::vector<float> a(80, 5.0F);
  std::vector<float> b(80, 5.0F);
  const auto change_db = [&](double row_cells) {
    return acoustics::dark_change_db({a.data(), b.data(), 8, 10, 1.0F, row_cells, 0.0}, dark);
  };
  // Two of ten pixels in row 2, three in row 5.
  for (const std::size_t i : {20U, 21U, 50U, 51U, 52U}) {
    a[i] = 0.5F;
    b[i] = i < 30 ? 1.9F : 1.0F;
  }
  CHECK(change_db(0.0) == near(20.0 * std::log10(2.0), 1e-3));
  // A neighbouring row is brighter: half a cell explains some of it.
  CHECK(change_db(0.5) < 1e-3);
}

}  // namespace
