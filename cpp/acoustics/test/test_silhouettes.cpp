#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "mapperd/acoustics/mesh_edges.hpp"
#include "mapperd/acoustics/silhouettes.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr std::size_t kSide = 8;
constexpr double kStep = 0.05;

// A fan of 8 x 8 cells about straight ahead, whose rays met nothing.
struct Fan {
  std::vector<float> direction, cell, range_m;
  std::vector<double> row_edges;
  std::vector<std::int32_t> rays;

  Fan() {
    for (std::size_t k = 0; k <= kSide; ++k) {
      row_edges.push_back(kStep * (static_cast<double>(k) - 0.5 * kSide));
    }
    for (std::size_t column = 0; column < kSide; ++column) {
      for (std::size_t row = 0; row < kSide; ++row) {
        const double s = row_edges[column] + 0.5 * kStep, w = row_edges[row] + 0.5 * kStep;
        for (const double axis : {std::sqrt(1.0 - s * s - w * w), -s, w}) {
          direction.push_back(static_cast<float>(axis));
        }
        for (const double edge :
             {row_edges[column], row_edges[column + 1], row_edges[row], row_edges[row + 1]}) {
          cell.push_back(static_cast<float>(edge));
        }
        rays.push_back(static_cast<std::int32_t>(range_m.size()));
        range_m.push_back(std::numeric_limits<float>::infinity());
      }
    }
  }

  [[nodiscard]] acoustics::RefinedRays refined(const acoustics::MeshEdges& mesh) const {
    const acoustics::SeenMesh seen{&mesh, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {}, {}};
    return acoustics::refined_rays(
        {kSide, kSide, row_edges[0], kStep, row_edges.data(), rays.data()},
        {range_m.size(), range_m.data(), direction.data(), cell.data()}, {seen}, {}, 20.0,
        {{}, {0, 0, 1}, 0.0});
  }
};

// A triangle across the way at 10 m.
acoustics::MeshEdges triangle(const std::vector<float>& y_z) {
  std::vector<float> corners;
  for (std::size_t k = 0; k < 3; ++k) {
    corners.insert(corners.end(), {10.0F, y_z[2 * k], y_z[2 * k + 1]});
  }
  const float normal[3] = {-1.0F, 0.0F, 0.0F};
  const std::int32_t surface = 0;
  return acoustics::mesh_edges(corners.data(), normal, &surface, 1);
}

double area_of(const acoustics::RefinedRays& rays, const std::vector<float>& y_z, bool inside) {
  double area = 0.0;
  for (std::size_t i = 0; i < rays.column.size(); ++i) {
    const float* d = rays.direction.data() + 3 * i;
    const float y = 10.0F * d[1] / d[0], z = 10.0F * d[2] / d[0];
    bool in = true;
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t n = (k + 1) % 3;
      const float turn = (y_z[2 * n] - y_z[2 * k]) * (z - y_z[2 * k + 1]) -
                         (y_z[2 * n + 1] - y_z[2 * k + 1]) * (y - y_z[2 * k]);
      in = in && turn > 0.0F;
    }
    const float* cell = rays.cell.data() + 4 * i;
    if (in || !inside) {
      area += static_cast<double>(cell[1] - cell[0]) * static_cast<double>(cell[3] - cell[2]);
    }
  }
  return area;
}

TEST_CASE("a triangle that no ray meets gets rays, and its own area") {
  const Fan fan;
  for (const float size : {1.0F, 0.1F, 0.01F}) {
    const std::vector<float> y_z{
        0.11F, 0.12F, 0.11F + size, 0.12F + 0.1F * size, 0.11F + 0.2F * size, 0.12F + size};
    const acoustics::RefinedRays rays = fan.refined(triangle(y_z));
    const double whole = std::pow(kStep * static_cast<double>(kSide), 2);
    CHECK(area_of(rays, y_z, false) == near(whole, 1e-5));
    const auto twice = static_cast<double>((y_z[2] - y_z[0]) * (y_z[5] - y_z[1]) -
                                           (y_z[3] - y_z[1]) * (y_z[4] - y_z[0]));
    CHECK(area_of(rays, y_z, true) / (0.5 * twice / 100.0) == near(1.0, 0.02));
  }
}

TEST_CASE("a part of a fan is refined as in the whole fan") {
  // Triangles in and about the part, near each other and far apart.
  std::vector<float> corners, normals;
  std::uint32_t bits = 1;
  const auto draw = [&bits](float low, float high) {
    bits = bits * 1664525U + 1013904223U;
    return low + (high - low) * static_cast<float>(bits >> 8) / static_cast<float>(1U << 24);
  };
  constexpr std::size_t kTriangles = 400;
  for (std::size_t i = 0; i < kTriangles; ++i) {
    const float x = draw(-2.0F, 12.0F), y = draw(-4.0F, 4.0F), z = draw(-4.0F, 4.0F);
    for (int k = 0; k < 3; ++k) {
      for (const float axis : {x, y, z}) corners.push_back(axis + draw(-0.2F, 0.2F));
    }
    normals.insert(normals.end(), {-1.0F, 0.0F, 0.0F});
  }
  const std::vector<std::int32_t> surface(kTriangles, 0);
  const acoustics::MeshEdges mesh =
      acoustics::mesh_edges(corners.data(), normals.data(), surface.data(), kTriangles);
  const Fan whole;
  const acoustics::RefinedRays all = whole.refined(mesh);
  Fan part;
  const auto is_in = [](std::size_t cell) {
    return cell / kSide > 4 && cell % kSide > 0 && cell % kSide < 4;
  };
  std::size_t kept = 0;
  for (std::size_t cell = 0; cell < part.rays.size(); ++cell) {
    if (!is_in(cell)) {
      part.rays[cell] = -1;
      continue;
    }
    part.rays[cell] = static_cast<std::int32_t>(kept);
    std::copy_n(whole.direction.data() + 3 * cell, 3, part.direction.data() + 3 * kept);
    std::copy_n(whole.cell.data() + 4 * cell, 4, part.cell.data() + 4 * kept);
    ++kept;
  }
  part.direction.resize(3 * kept);
  part.cell.resize(4 * kept);
  part.range_m.resize(kept);
  const acoustics::RefinedRays some = part.refined(mesh);
  std::vector<float> expected;
  for (std::size_t i = 0; i < all.column.size(); ++i) {
    const auto s = 0.5 * static_cast<double>(all.cell[4 * i] + all.cell[4 * i + 1]);
    const auto w = 0.5 * static_cast<double>(all.cell[4 * i + 2] + all.cell[4 * i + 3]);
    const auto column = static_cast<std::size_t>((s - whole.row_edges[0]) / kStep);
    const auto row = static_cast<std::size_t>((w - whole.row_edges[0]) / kStep);
    if (!is_in(column * kSide + row)) continue;
    expected.insert(expected.end(), all.cell.begin() + static_cast<std::ptrdiff_t>(4 * i),
                    all.cell.begin() + static_cast<std::ptrdiff_t>(4 * i + 4));
  }
  CHECK(expected.size() > 8 * kept);
  CHECK(some.cell == expected);
}

TEST_CASE("without an outline every ray is kept as it is") {
  const Fan fan;
  const acoustics::RefinedRays rays = fan.refined(triangle({5.0F, 5.0F, 6.0F, 5.0F, 5.0F, 6.0F}));
  CHECK(rays.cell == fan.cell);
  CHECK(rays.direction == fan.direction);
  for (std::size_t i = 0; i < rays.from.size(); ++i) {
    CHECK(rays.from[i] == static_cast<std::int32_t>(i));
  }
}

TEST_CASE("an outline that passes by the sonar is seen ahead of it") {
  const std::vector<float> corners{-6.0F, 0.1F, -0.1F, 4.0F, 0.3F, -0.2F, 4.0F, -0.3F, -0.2F};
  const float normal[3] = {0.0F, 0.0F, 1.0F};
  const std::int32_t surface = 0;
  const acoustics::MeshEdges mesh = acoustics::mesh_edges(corners.data(), normal, &surface, 1);
  const acoustics::RefinedRays rays = Fan().refined(mesh);
  CHECK(std::count(rays.from.begin(), rays.from.end(), -1) > 8);
}

TEST_CASE("an outline behind what all rays about it met is hidden") {
  Fan fan;
  fan.range_m.assign(fan.range_m.size(), 5.0F);
  const acoustics::RefinedRays rays = fan.refined(triangle({0.0F, 0.0F, 0.5F, 0.0F, 0.0F, 0.5F}));
  CHECK(rays.from.size() == fan.rays.size());
}

TEST_CASE("edges within a plane are left out, creases and borders are told apart") {
  // Two faces of a square, and one that stands on its side.
  const std::vector<float> corners{0, 0, 0, 1, 0, 0, 1, 1, 0,  //
                                   0, 0, 0, 1, 1, 0, 0, 1, 0,  //
                                   1, 0, 0, 1, 0, 1, 1, 1, 0};
  const std::vector<float> normals{0, 0, 1, 0, 0, 1, -1, 0, 0};
  const std::vector<std::int32_t> surface{0, 0, 0};
  const acoustics::MeshEdges mesh =
      acoustics::mesh_edges(corners.data(), normals.data(), surface.data(), 3);
  std::size_t borders = 0, creases = 0;
  for (const acoustics::MeshEdge& edge : mesh.edges) {
    borders += edge.border ? 1 : 0;
    creases += edge.crease ? 1 : 0;
  }
  CHECK(mesh.edges.size() == 6);
  CHECK(borders == 5);
  CHECK(creases == 1);
}

}  // namespace
