#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <random>
#include <vector>

#include "mapperd/acoustics/ray_bundle.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr float kInfinite = std::numeric_limits<float>::infinity();

struct Found {
  std::vector<float> range_m;
  std::vector<std::int32_t> face;
};

Found cast(const std::vector<float>& corners, const std::array<double, 3>& origin,
           const std::vector<float>& directions, float reach_m = kInfinite,
           const float* near_m = nullptr, unsigned threads = 1) {
  const std::size_t count = directions.size() / 3;
  Found found{std::vector<float>(count, reach_m), std::vector<std::int32_t>(count, -1)};
  const acoustics::RayBundle rays{
      count, {origin[0], origin[1], origin[2]}, directions.data(), near_m};
  acoustics::cast_bundle(acoustics::pack_triangles(corners.data(), corners.size() / 9), rays, 0,
                         threads, found.range_m.data(), found.face.data());
  return found;
}

// Moeller and Trumbore in double precision; infinite where the ray misses. `margin` is the least
// barycentric coordinate where the ray meets the plane: near 0, rounding decides.
double distance(const float* corners, const std::array<double, 3>& origin, const float* direction,
                double& margin, double& t) {
  std::array<double, 3> u, v, s, d;
  for (std::size_t k = 0; k < 3; ++k) {
    u[k] = static_cast<double>(corners[3 + k]) - static_cast<double>(corners[k]);
    v[k] = static_cast<double>(corners[6 + k]) - static_cast<double>(corners[k]);
    s[k] = origin[k] - static_cast<double>(corners[k]);
    d[k] = static_cast<double>(direction[k]);
  }
  const auto cross = [](const auto& a, const auto& b) {
    return std::array<double, 3>{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                                 a[0] * b[1] - a[1] * b[0]};
  };
  const auto dot = [](const auto& a, const auto& b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  };
  const auto p = cross(d, v), q = cross(s, u);
  const double determinant = dot(u, p);
  const double a = dot(s, p) / determinant, b = dot(d, q) / determinant;
  t = dot(v, q) / determinant;
  margin = std::min({a, b, 1.0 - a - b});
  return margin >= 0.0 && t > 0.0 ? t : std::numeric_limits<double>::infinity();
}

std::vector<float> random_directions(std::mt19937& dice, std::size_t count, double width) {
  std::normal_distribution<double> normal;
  std::vector<float> directions;
  for (std::size_t i = 0; i < count; ++i) {
    double d[3] = {1.0 + width * normal(dice), width * normal(dice), width * normal(dice)};
    const double length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (const double part : d) directions.push_back(static_cast<float>(part / length));
  }
  return directions;
}

// Triangles of all sizes about the origin: slivers, and some that reach around it.
std::vector<float> random_triangles(std::mt19937& dice, std::size_t count) {
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> power(-2.5F, 1.3F);
  std::vector<float> corners;
  for (std::size_t i = 0; i < count; ++i) {
    const float size = std::pow(10.0F, power(dice)), thin = i % 3 == 0 ? 0.01F : 1.0F;
    const float at[3] = {4.0F * normal(dice), 4.0F * normal(dice), 4.0F * normal(dice)};
    for (std::size_t corner = 0; corner < 3; ++corner) {
      for (std::size_t k = 0; k < 3; ++k) {
        corners.push_back(at[k] + size * (k == 0 ? thin : 1.0F) * normal(dice));
      }
    }
  }
  return corners;
}

TEST_CASE("every ray meets the triangle that a search over all of them finds") {
  std::mt19937 dice(5);
  // In all directions, in a narrow fan, and a ray alone.
  for (const auto& [count, width] : {std::pair{3000U, 3.0}, {60000U, 0.3}, {1U, 0.5}}) {
    for (const std::size_t triangles : {1U, 32U, 33U, count > 10000U ? 60U : 400U}) {
      const std::vector<float> corners = random_triangles(dice, triangles);
      const std::vector<float> directions = random_directions(dice, count, width);
      const std::array<double, 3> origin{0.3, -0.2, 0.1};
      const Found found = cast(corners, origin, directions);
      std::size_t doubtful = 0;  // rays at an edge of what they meet first
      for (std::size_t ray = 0; ray < count; ++ray) {
        double nearest = std::numeric_limits<double>::infinity(), at_edge_m = nearest;
        std::int32_t face = -1;
        for (std::size_t i = 0; i < triangles; ++i) {
          double margin = 0.0, t_of_plane = 0.0;
          const double t = distance(corners.data() + 9 * i, origin, directions.data() + 3 * ray,
                                    margin, t_of_plane);
          if (std::fabs(margin) < 1e-3 && t_of_plane > 0.0)
            at_edge_m = std::min(at_edge_m, t_of_plane);
          if (t < nearest) {
            nearest = t;
            face = static_cast<std::int32_t>(i);
          }
        }
        if (std::isfinite(at_edge_m) && at_edge_m <= nearest) {
          ++doubtful;
        } else {
          REQUIRE(found.face[ray] == face);
          if (face >= 0) {
            REQUIRE(static_cast<double>(found.range_m[ray]) == near(nearest, 1e-4 * nearest));
          } else {
            REQUIRE(found.range_m[ray] == kInfinite);
          }
        }
      }
      CHECK(doubtful < 1 + count / 15);
    }
  }
}

// A closed surface of small and large triangles about the origin.
std::vector<float> shell(std::mt19937& dice) {
  constexpr std::size_t kRound = 37, kUp = 19;
  std::uniform_real_distribution<float> radius(3.0F, 4.0F);
  std::array<std::array<std::array<float, 3>, kRound>, kUp + 1> at;
  for (std::size_t row = 0; row <= kUp; ++row) {
    for (std::size_t k = 0; k < kRound; ++k) {
      const float up = 3.14159265F * (static_cast<float>(row) / kUp - 0.5F);
      const float round = 6.2831853F * static_cast<float>(k) / kRound;
      const bool pole = row == 0 || row == kUp;
      const float r = pole ? 3.5F : radius(dice), level = pole ? 0.0F : r * std::cos(up);
      at[row][k] = {level * std::cos(round), level * std::sin(round), r * std::sin(up)};
    }
  }
  std::vector<float> corners;
  for (std::size_t row = 0; row < kUp; ++row) {
    for (std::size_t k = 0; k < kRound; ++k) {
      const auto &a = at[row][k], &b = at[row][(k + 1) % kRound];
      const auto &c = at[row + 1][(k + 1) % kRound], &d = at[row + 1][k];
      for (const auto& corner : {a, b, c, a, c, d}) {
        corners.insert(corners.end(), corner.begin(), corner.end());
      }
    }
  }
  return corners;
}

TEST_CASE("no ray leaves a closed surface, not even through a corner or an edge") {
  std::mt19937 dice(7);
  const std::vector<float> corners = shell(dice);
  for (const std::array<double, 3>& origin :
       {std::array{0.0, 0.0, 0.0}, {1.1, -0.7, 2.0}, {-2.5, 0.3, 0.1}}) {
    std::vector<float> directions = random_directions(dice, 2000, 5.0);
    for (std::size_t corner = 0; corner + 6 <= corners.size(); corner += 3) {
      for (const float part : {0.0F, 0.3F, 0.5F}) {
        double d[3], square = 0.0;
        for (std::size_t k = 0; k < 3; ++k) {
          const float to =
              corners[corner + k] + part * (corners[corner + 3 + k] - corners[corner + k]);
          d[k] = static_cast<double>(to) - origin[k];
          square += d[k] * d[k];
        }
        for (const double axis : d)
          directions.push_back(static_cast<float>(axis / std::sqrt(square)));
      }
    }
    const Found found = cast(corners, origin, directions);
    CHECK(std::count(found.face.begin(), found.face.end(), -1) == 0);
    CHECK(*std::max_element(found.range_m.begin(), found.range_m.end()) < 8.0F);
  }
}

TEST_CASE("what a ray meets depends neither on the other rays nor on the threads") {
  std::mt19937 dice(9);
  const std::vector<float> corners = random_triangles(dice, 500);
  const std::vector<float> directions = random_directions(dice, 20000, 1.0);
  const Found found = cast(corners, {}, directions);
  const Found shared = cast(corners, {}, directions, kInfinite, nullptr, 3);
  CHECK((shared.face == found.face && shared.range_m == found.range_m));
  for (std::size_t ray = 0; ray < 20000; ray += 97) {
    const std::vector<float> alone(directions.begin() + static_cast<std::ptrdiff_t>(3 * ray),
                                   directions.begin() + static_cast<std::ptrdiff_t>(3 * ray + 3));
    const Found one = cast(corners, {}, alone);
    REQUIRE((one.face[0] == found.face[ray] && one.range_m[0] == found.range_m[ray]));
  }
}

TEST_CASE("near and far limits") {
  std::vector<float> corners;
  for (const float x : {1.0F, 2.0F, 3.0F}) {
    for (const float corner : {x, -9.0F, -9.0F, x, 9.0F, -9.0F, x, 0.0F, 9.0F}) {
      corners.push_back(corner);
    }
  }
  const std::vector<float> ahead{1.0F, 0.0F, 0.0F};
  const auto face = [&](float near_m, float reach_m) {
    return cast(corners, {}, ahead, reach_m, &near_m).face[0];
  };
  CHECK(face(0.0F, 9.0F) == 0);
  CHECK(face(1.0F, 9.0F) == 1);  // not farther than that
  CHECK(face(2.5F, 9.0F) == 2);
  CHECK(face(1.5F, 2.0F) == -1);  // not nearer than that
  CHECK(face(kInfinite, kInfinite) == -1);
  CHECK(cast(corners, {}, ahead, 0.5F).range_m[0] == 0.5F);
}

TEST_CASE("an origin in a face sees what is behind that face") {
  std::mt19937 dice(3);
  for (const float lean : {0.0F, 0.37F}) {
    const float size = 50.0F;
    const std::vector<float> corners{-lean * size, -size, -size, -lean * size, size,  -size,
                                     lean * size,  0.0F,  size,  2.0F,         -9.0F, -9.0F,
                                     2.0F,         9.0F,  -9.0F, 2.0F,         0.0F,  9.0F};
    const Found found = cast(corners, {}, random_directions(dice, 100, 0.1));
    CHECK(std::count(found.face.begin(), found.face.end(), 1) == 100);
  }
}

TEST_CASE("no triangles, no rays and triangles without area") {
  std::mt19937 dice(1);
  const std::vector<float> directions = random_directions(dice, 10, 0.5);
  CHECK(cast({}, {}, directions).face == std::vector<std::int32_t>(10, -1));
  CHECK(cast(random_triangles(dice, 3), {}, {}).face.empty());
  const std::vector<float> flat{1.0F, 0.0F, 0.0F, 1.0F, 0.0F, 0.0F, 1.0F, 1.0F, 0.0F,
                                0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F};
  CHECK(cast(flat, {}, directions).face == std::vector<std::int32_t>(10, -1));
}

TEST_CASE("rays without a direction meet nothing and hinder no others") {
  const std::vector<float> wall{2.0F, -9.0F, -9.0F, 2.0F, 9.0F, -9.0F, 2.0F, 0.0F, 9.0F};
  const std::vector<float> directions{1.0F, 0.0F, 0.0F, NAN, 0.0F, 0.0F, 0.0F, 0.0F,
                                      0.0F, NAN,  NAN,  NAN, 0.8F, 0.6F, 0.0F};
  for (const float reach_m : {9.0F, kInfinite}) {
    CHECK(cast(wall, {}, directions, reach_m).face == std::vector<std::int32_t>{0, -1, -1, -1, 0});
  }
}

TEST_CASE("of triangles at one range the first is met, whatever else is cast") {
  // A wall of squares that lies there twice: each edge is shared, each square has a twin.
  std::vector<float> corners;
  for (int copy = 0; copy < 2; ++copy) {
    for (int i = 0; i < 30; ++i) {
      for (int j = 0; j < 30; ++j) {
        const float y = static_cast<float>(i) / 4 - 3.5F, z = static_cast<float>(j) / 4 - 3.5F;
        corners.insert(corners.end(), {2.0F, y, z, 2.0F, y + 0.25F, z, 2.0F, y, z + 0.25F});
      }
    }
  }
  std::mt19937 dice(8);
  std::vector<float> directions = random_directions(dice, 4000, 0.8);
  for (int i = 0; i < 2000; ++i) {
    const float y = static_cast<float>(i % 29) / 4 - 3.5F,
                z = static_cast<float>(i / 70) / 4 - 3.5F;
    const float length = std::sqrt(4.0F + y * y + z * z);
    directions.insert(directions.end(), {2.0F / length, y / length, z / length});
  }
  const Found all = cast(corners, {}, directions);
  CHECK(*std::max_element(all.face.begin(), all.face.end()) < 900);
  for (std::size_t ray = 0; ray + 4 < 6000; ray += 4) {
    const std::vector<float> few(directions.begin() + static_cast<std::ptrdiff_t>(3 * ray),
                                 directions.begin() + static_cast<std::ptrdiff_t>(3 * ray + 12));
    const Found found = cast(corners, {}, few);
    REQUIRE(std::equal(found.face.begin(), found.face.end(),
                       all.face.begin() + static_cast<std::ptrdiff_t>(ray)));
  }
}

TEST_CASE("no ray leaves a large box from beside its wall") {
  std::mt19937 dice(6);
  for (const float half_m : {100.0F, 1000.0F}) {
    std::vector<float> corners;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (const float side : {-half_m, half_m}) {
        for (const float turn : {-1.0F, 1.0F}) {
          const float flat[3][2] = {
              {-half_m, -half_m}, {half_m, half_m}, {turn * half_m, -turn * half_m}};
          for (const auto& at : flat) {
            float corner[3];
            corner[axis] = side;
            corner[(axis + 1) % 3] = at[0];
            corner[(axis + 2) % 3] = at[1];
            // Turned: no wall is along an axis.
            const float x = 0.8F * corner[0] - 0.6F * corner[1],
                        y = 0.6F * corner[0] + 0.8F * corner[1];
            corners.insert(corners.end(),
                           {x, 0.8F * y - 0.6F * corner[2], 0.6F * y + 0.8F * corner[2]});
          }
        }
      }
    }
    for (const double off_m : {0.001, 0.1}) {
      // Beside the wall whose outward normal is (0.8, 0.48, 0.36).
      const double along = static_cast<double>(half_m) - off_m - (half_m > 500.0F ? 1e-3 : 0.0);
      const Found found = cast(corners, {0.8 * along, 0.48 * along, 0.36 * along},
                               random_directions(dice, 40000, 5.0));
      CHECK(std::count(found.face.begin(), found.face.end(), -1) == 0);
    }
  }
}

TEST_CASE("meshes are cast one after the other, with limits of each ray's own") {
  std::mt19937 dice(12);
  constexpr std::size_t kCount = 20000;
  const std::vector<float> first = random_triangles(dice, 200),
                           second = random_triangles(dice, 150);
  std::vector<float> both = first;
  both.insert(both.end(), second.begin(), second.end());
  const std::vector<float> directions = random_directions(dice, kCount, 2.0);
  std::uniform_real_distribution<float> some_m(0.0F, 3.0F);
  std::vector<float> near_m(kCount);
  for (float& at : near_m) at = some_m(dice);
  Found found{std::vector<float>(kCount, 9.0F), std::vector<std::int32_t>(kCount, -1)};
  const acoustics::RayBundle rays{kCount, {0.1, 0.2, 0.3}, directions.data(), near_m.data()};
  const auto enter = [&](const std::vector<float>& corners, std::int32_t first_face) {
    acoustics::cast_bundle(acoustics::pack_triangles(corners.data(), corners.size() / 9), rays,
                           first_face, 3, found.range_m.data(), found.face.data());
  };
  enter(first, 0);
  enter(second, 200);
  const Found expected = cast(both, {0.1, 0.2, 0.3}, directions, 9.0F, near_m.data());
  CHECK((found.face == expected.face && found.range_m == expected.range_m));
  std::size_t met = 0;
  for (std::size_t i = 0; i < kCount; ++i) {
    if (found.face[i] < 0) continue;
    ++met;
    REQUIRE((found.range_m[i] > near_m[i] && found.range_m[i] < 9.0F));
  }
  CHECK(met > kCount / 10);
}

TEST_CASE("rays near a ball are all that come near it") {
  std::mt19937 dice(4);
  const std::vector<float> directions = random_directions(dice, 5000, 0.6);
  std::vector<double> starts;
  for (int i = 0; i < 5000; ++i) starts.insert(starts.end(), {0.25, 1e-4 * i, 0.25});
  const double middle[3] = {3.0, 0.5, 0.2}, radius = 0.8, reach = 3.0;
  const auto near =
      acoustics::rays_near_ball(5000, starts.data(), directions.data(), reach, middle, radius);
  std::vector<std::int64_t> expected;
  for (std::size_t i = 0; i < 5000; ++i) {
    double least = 1e9;
    for (int step = 0; step <= 3000; ++step) {
      double square = 0.0;
      for (std::size_t k = 0; k < 3; ++k) {
        const double at =
            starts[3 * i + k] + 1e-3 * step * static_cast<double>(directions[3 * i + k]);
        square += (at - middle[k]) * (at - middle[k]);
      }
      least = std::min(least, square);
    }
    if (std::sqrt(least) <= radius) expected.push_back(static_cast<std::int64_t>(i));
  }
  std::vector<std::int64_t> differing;
  std::set_symmetric_difference(near.begin(), near.end(), expected.begin(), expected.end(),
                                std::back_inserter(differing));
  CHECK(differing.size() < 4);  // the steps of the search are wide
  CHECK(expected.size() > 100);
}

// Which cells of 0.03 x 0.04 hold a direction through a window, by many directions of each.
std::vector<bool> held(const std::vector<float>& directions, const std::vector<float>& cells,
                       const acoustics::MirrorWindow& window) {
  std::vector<bool> through(directions.size() / 3, false);
  for (std::size_t i = 0; i < through.size(); ++i) {
    for (int k = 0; k < 21 * 21 && !through[i]; ++k) {
      const float* cell = cells.data() + 4 * i;
      const double s = static_cast<double>(cell[0]) + (k % 21) / 20.0 * 0.03;
      const double w = static_cast<double>(cell[2]) + (k / 21) / 20.0 * 0.04;
      const double x2 = 1.0 - s * s - w * w;
      if (x2 <= 0.0) continue;
      const mapperd::Vec3 way = window.map_T_fan.rotate({std::sqrt(x2), -s, w});
      const double cosine = dot(way, window.normal);
      if (cosine <= 0.0 || window.height_m / cosine > window.reach_m) continue;
      const mapperd::Vec3 at = window.map_T_fan.translation + (window.height_m / cosine) * way;
      bool inside = true;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        inside = inside && at[axis] > window.low_m[axis] && at[axis] < window.high_m[axis];
      }
      through[i] = inside;
    }
  }
  return through;
}

TEST_CASE("cells through a window are all that hold a direction through it, and few more") {
  // The fan looks along x from 1.5 m before a plane that leans, mirrored.
  acoustics::MirrorWindow window{};
  window.map_T_fan.rows = {mapperd::Vec3{1, 0, 0}, mapperd::Vec3{0, -1, 0}, mapperd::Vec3{0, 0, 1}};
  window.map_T_fan.translation = {1.0, 2.0, 3.0};
  window.normal = {0.8, 0.6, 0.0};
  window.height_m = 1.5;
  window.low_m = {1.8, 2.3, 2.8};
  window.high_m = {2.9, 3.5, 3.6};
  window.reach_m = 4.0;
  std::vector<float> directions, cells;
  for (int column = 0; column < 60; ++column) {
    for (int row = 0; row < 40; ++row) {
      const double s0 = -0.9 + 0.03 * column, w0 = -0.8 + 0.04 * row;
      const double s = s0 + 0.015, w = w0 + 0.02;
      if (s * s + w * w >= 0.99) continue;
      for (const double axis : {std::sqrt(1.0 - s * s - w * w), -s, w}) {
        directions.push_back(static_cast<float>(axis));
      }
      for (const double edge : {s0, s0 + 0.03, w0, w0 + 0.04}) {
        cells.push_back(static_cast<float>(edge));
      }
    }
  }
  const std::size_t count = directions.size() / 3;
  // And close above a plane that most of its rays graze.
  acoustics::MirrorWindow grazed = window;
  grazed.normal = {0.0, 0.0, -1.0};
  grazed.height_m = 0.1;
  grazed.low_m = {1.0, 0.0, 2.8};
  grazed.high_m = {5.0, 4.0, 3.0};
  for (const acoustics::MirrorWindow& one : {window, grazed}) {
    const auto kept =
        acoustics::cells_through_window({count, directions.data(), cells.data()}, one);
    const std::vector<bool> through = held(directions, cells, one);
    for (std::size_t i = 0; i < count; ++i) {
      const bool found = std::binary_search(kept.begin(), kept.end(), static_cast<std::int64_t>(i));
      CHECK((found || !through[i]));
    }
    CHECK(std::count(through.begin(), through.end(), true) > 30);
    CHECK(kept.size() < (one.height_m > 1.0 ? count / 2 : 2 * count / 3));
  }
  // Where the fan looks away from the plane, cells at its rim and along the plane are kept at most.
  acoustics::MirrorWindow behind = window;
  behind.normal = {-0.8, -0.6, 0.0};
  CHECK(acoustics::cells_through_window({count, directions.data(), cells.data()}, behind).size() <
        count / 5);
}

TEST_CASE("rays from below meet the sea before what is farther off") {
  const std::vector<float> up{0, 0, 1, 0, 0, 1, 0, 0, 1, 0.8F, 0, 0.6F, 1, 0, 0, 0, 0, -1};
  const std::vector<float> near_m{0.0F, 0.0F, 5.0F, 0.0F, 0.0F, 0.0F};
  const acoustics::RayBundle rays{6, {}, up.data(), near_m.data()};
  std::vector<float> range_m{9.0F, 2.0F, 9.0F, 9.0F, 9.0F, 9.0F};
  std::vector<std::int32_t> face(6, -1), group(6, 0);
  acoustics::meet_sea(rays, {0.0, 4, 2}, range_m.data(), face.data(), group.data());
  CHECK(face == std::vector<std::int32_t>(6, -1));
  acoustics::meet_sea(rays, {3.0, 4, 2}, range_m.data(), face.data(), group.data());
  CHECK(face == std::vector<std::int32_t>{4, -1, -1, 4, -1, -1});
  CHECK(group == std::vector<std::int32_t>{2, 0, 0, 2, 0, 0});
  CHECK(range_m[0] == 3.0F);
  CHECK(range_m[1] == 2.0F);
  CHECK(range_m[3] == doctest::Approx(5.0));
}

}  // namespace
