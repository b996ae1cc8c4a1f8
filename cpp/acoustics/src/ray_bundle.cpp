#include "mapperd/acoustics/ray_bundle.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "mapperd/common/parallel.hpp"
#include "mapperd/common/simd.hpp"
#include "morton.hpp"

namespace mapperd::acoustics {

namespace {

constexpr std::size_t kLanes = 8;
constexpr float kSlack = 1e-5F;    // of tangents, against rounding: more rays are tried
constexpr float kOverlap = 2e-7F;  // rad, of triangles that share a corner, against rounding
constexpr float kTiny = 1e-30F;    // keeps edges without length finite
constexpr double kClosest = 1e-6;  // m; corners nearer have no tangents worth trusting
constexpr float kSteep = 4.0F;     // triangles with tangents beyond it need clipping
constexpr std::size_t kMaxCorners =
    16;  // of a clipped triangle: 7, of a thin one up to 13 by rounding
constexpr std::int32_t kFewRays = 24;  // so many are tried without clipping triangles by rows
constexpr std::size_t kRaysPerCell = 1;
constexpr std::size_t kCellsPerRow = 16;      // for each row of cells
constexpr std::size_t kRaysPerThread = 4096;  // at least
constexpr float kInfinite = std::numeric_limits<float>::infinity();

template <typename Real>
struct Point {
  Real across, up, ahead;
};

constexpr std::size_t kSize = TrianglePack::kSize;

// Triangles as rays see them. A direction is inside one if it is on the inner side of the three
// planes through the origin and an edge.
struct Facets {
  float corner[3][3][kSize];       // from the rays' origin
  float edge_normal[3][3][kSize];  // unit normals of those planes
  float normal[3][kSize];
  float height[kSize];
};

MAPPERD_VECTORISED void set_corners(const TrianglePack& pack, const double* origin_m, Facets& to) {
  for (std::size_t k = 0; k < 3; ++k) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double at = origin_m[axis];
      for (std::size_t i = 0; i < kSize; ++i) {
        to.corner[k][axis][i] =
            static_cast<float>(static_cast<double>(pack.corner_m[k][axis][i]) - at);
      }
    }
  }
}

// The plane of an edge is along (a + b) x (b - a): opposite to the bit for two triangles that share
// the edge, and exact for a small triangle far off.
MAPPERD_VECTORISED void set_planes(Facets& to) {
  for (std::size_t i = 0; i < kSize; ++i) {
    const auto part = [&](std::size_t k, std::size_t axis) { return to.corner[k][axis][i]; };
    const auto edge = [&](std::size_t k, std::size_t axis) {
      return part(k, axis) - part(0, axis);
    };
    float normal[3];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t u = axis == 2 ? 0 : axis + 1, v = axis == 0 ? 2 : axis - 1;
      normal[axis] = edge(1, u) * edge(2, v) - edge(1, v) * edge(2, u);
    }
    const float height = normal[0] * part(0, 0) + normal[1] * part(0, 1) + normal[2] * part(0, 2);
    const float sign = height < 0.0F ? -1.0F : 1.0F;
    to.height[i] = sign * height;
    for (std::size_t axis = 0; axis < 3; ++axis) to.normal[axis][i] = sign * normal[axis];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t next = k == 2 ? 0 : k + 1;
      float edge_normal[3], square = 0.0F;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::size_t u = axis == 2 ? 0 : axis + 1, v = axis == 0 ? 2 : axis - 1;
        const float sum_u = part(k, u) + part(next, u), sum_v = part(k, v) + part(next, v);
        const float edge_u = part(next, u) - part(k, u), edge_v = part(next, v) - part(k, v);
        edge_normal[axis] = sum_u * edge_v - sum_v * edge_u;
        square += edge_normal[axis] * edge_normal[axis];
      }
      const float scale = sign / std::sqrt(std::max(square, kTiny));
      for (std::size_t axis = 0; axis < 3; ++axis)
        to.edge_normal[k][axis][i] = scale * edge_normal[axis];
    }
  }
}

// Where rays lie in the cube of directions: on the side of their longest part, by the other two.
MAPPERD_VECTORISED void set_tangents(const float* __restrict direction, std::size_t count,
                                     std::uint32_t* __restrict side, float* __restrict across,
                                     float* __restrict up) {
  for (std::size_t i = 0; i < count; ++i) {
    const float x = direction[3 * i], y = direction[3 * i + 1], z = direction[3 * i + 2];
    const bool second = std::fabs(y) > std::fabs(x);
    const float most = second ? std::fabs(y) : std::fabs(x);
    const bool third = std::fabs(z) > most;
    const float ahead = third ? z : (second ? y : x);
    const float scale = 1.0F / std::fabs(ahead);
    across[i] = (third ? x : (second ? z : y)) * scale;
    up[i] = (third ? y : (second ? x : z)) * scale;
    side[i] = (third ? 4U : (second ? 2U : 0U)) + (ahead < 0.0F ? 1U : 0U);
  }
}

// Rays cell after cell, and room for a whole vector behind the last one.
struct SortedRays {
  std::vector<float> x, y, z, near_m, range_m;
  std::vector<std::int32_t> face;
  std::vector<std::uint32_t> place;  // among those given

  explicit SortedRays(std::size_t count)
      : x(count + kLanes), y(x), z(x), near_m(x), range_m(x), face(count + kLanes), place(count) {}
};

// The rays whose largest part is along one axis, by their tangents across and up.
struct CubeSide {
  std::size_t axis, across, up;
  float sign;
  float low[2] = {kInfinite, kInfinite}, high[2] = {-kInfinite, -kInfinite};
  float scale[2] = {0.0F, 0.0F};
  std::size_t count = 0, rows = 0, cells = 0;  // rays, rows of cells, cells in a row
  std::vector<std::uint32_t> first;            // ray of each cell, and the end
  std::vector<std::int32_t> before;  // rays in lower rows and lower cells, (rows + 1, cells + 1)

  void build_grid() {
    if (count == 0) return;
    const double wanted = std::sqrt(static_cast<double>(count) / (kRaysPerCell * kCellsPerRow));
    rows = static_cast<std::size_t>(std::clamp(wanted, 1.0, 1024.0));
    cells = kCellsPerRow * rows;
    scale[0] = static_cast<float>(cells) / std::max(high[0] - low[0], kSlack);
    scale[1] = static_cast<float>(rows) / std::max(high[1] - low[1], kSlack);
    first.assign(rows * cells + 1, 0);
  }

  // To be called when the rays are sorted.
  void count_rays() {
    before.assign((rows + 1) * (cells + 1), 0);
    for (std::size_t row = 0; row < rows; ++row) {
      const std::uint32_t* line = first.data() + row * cells;
      const std::int32_t* below = before.data() + row * (cells + 1);
      std::int32_t* to = before.data() + (row + 1) * (cells + 1);
      for (std::size_t i = 0; i <= cells; ++i) {
        to[i] = below[i] + static_cast<std::int32_t>(line[i] - line[0]);
      }
    }
  }

  Point<float> seen(const float* point) const {
    return {point[across], point[up], sign * point[axis]};
  }

  MAPPERD_INLINE Point<float> corner(const Facets& facets, std::size_t k, std::size_t i) const {
    const auto& at = facets.corner[k];
    return {at[across][i], at[up][i], sign * at[axis][i]};
  }

  std::size_t cell(std::size_t k, float tangent) const {
    const float at = (tangent - low[k]) * scale[k];
    if (!(at > 0.0F)) return 0;  // also NaN
    return static_cast<std::size_t>(std::min(at, static_cast<float>((k == 0 ? cells : rows) - 1)));
  }

  // Distance of a point into the view frustum of the rays, from one of its planes.
  template <typename Real>
  Real depth(std::size_t plane, const Point<Real>& p) const {
    const std::size_t side = plane / 2;
    const Real tangent = side == 0 ? p.across : p.up;
    return plane % 2 == 0 ? tangent - static_cast<Real>(low[side] - kSlack) * p.ahead
                          : static_cast<Real>(high[side] + kSlack) * p.ahead - tangent;
  }

  // Whether no ray can meet a box.
  bool out_of_view(const float* middle, const float* half) const {
    const Point<float> at = seen(middle);
    if (at.ahead + half[axis] <= 0.0F) return true;
    for (std::size_t plane = 0; plane < 4; ++plane) {
      const float edge = plane % 2 == 0 ? low[plane / 2] - kSlack : high[plane / 2] + kSlack;
      const float reach = half[plane < 2 ? across : up] + std::fabs(edge) * half[axis];
      if (depth(plane, at) + reach * (1.0F + kSlack) < 0.0F) return true;
    }
    return false;
  }
};

class Bundle {
 public:
  Bundle(const RayBundle& rays, const float* range_m, std::size_t first, std::size_t last)
      : count_(last - first), rays_(count_), sides_(6) {
    for (std::size_t s = 0; s < 6; ++s) {
      sides_[s].axis = s / 2;
      sides_[s].across = (s / 2 + 1) % 3;
      sides_[s].up = (s / 2 + 2) % 3;
      sides_[s].sign = s % 2 == 0 ? 1.0F : -1.0F;
    }
    for (std::size_t k = 0; k < 3; ++k) origin_m_[k] = rays.origin_m[k];
    sort(rays, range_m, first);
  }

  void intersect(const std::vector<TrianglePack>& mesh, std::int32_t first_face) {
    Facets facets;
    Shapes shapes;
    for (const TrianglePack& pack : mesh) {
      float middle[3];
      double square = 0.0;
      for (std::size_t k = 0; k < 3; ++k) {
        const double away = static_cast<double>(pack.middle_m[k]) - origin_m_[k];
        middle[k] = static_cast<float>(away);
        const double gap = std::fabs(away) - static_cast<double>(pack.half_m[k]);
        square += gap > 0.0 ? gap * gap : 0.0;
      }
      if (std::sqrt(square) > static_cast<double>(reach_m_)) continue;
      bool placed = false, ready = false;
      for (const CubeSide& side : sides_) {
        if (side.cells == 0 || side.out_of_view(middle, pack.half_m)) continue;
        if (!placed) set_corners(pack, origin_m_, facets);
        placed = true;
        set_shapes(facets, side, shapes);
        if (!set_cells(side, shapes)) continue;
        if (!ready) set_planes(facets);
        ready = true;
        test_triangles(facets, shapes, pack.index, first_face, side, rays_);
      }
    }
  }

  void write_hits(float* range_m, std::int32_t* face) const {
    for (std::size_t i = 0; i < count_; ++i) {
      if (rays_.face[i] < 0) continue;
      range_m[rays_.place[i]] = rays_.range_m[i];
      face[rays_.place[i]] = rays_.face[i];
    }
  }

 private:
  void sort(const RayBundle& rays, const float* range_m, std::size_t first) {
    std::vector<std::uint32_t> side_of(count_);
    std::vector<float> across(count_), up(count_);
    const float* directions = rays.direction + 3 * first;
    set_tangents(directions, count_, side_of.data(), across.data(), up.data());
    for (std::size_t i = 0; i < count_; ++i) {
      CubeSide& side = sides_[side_of[i]];
      side.low[0] = std::min(side.low[0], across[i]);
      side.high[0] = std::max(side.high[0], across[i]);
      side.low[1] = std::min(side.low[1], up[i]);
      side.high[1] = std::max(side.high[1], up[i]);
      ++side.count;
    }
    for (CubeSide& side : sides_) side.build_grid();
    std::vector<std::uint32_t> cell_of(count_);
    for (std::size_t i = 0; i < count_; ++i) {
      CubeSide& side = sides_[side_of[i]];
      const std::size_t cell = side.cell(1, up[i]) * side.cells + side.cell(0, across[i]);
      ++side.first[cell];
      cell_of[i] = static_cast<std::uint32_t>(cell);
    }
    std::uint32_t before = 0;
    for (CubeSide& side : sides_) {
      for (std::uint32_t& at : side.first) at = before += at;
    }
    for (std::size_t i = count_; i-- > 0;) {
      // From the last ray to the first, each cell is filled from its end.
      const std::uint32_t to = --sides_[side_of[i]].first[cell_of[i]];
      const float* d = directions + 3 * i;
      rays_.x[to] = d[0];
      rays_.y[to] = d[1];
      rays_.z[to] = d[2];
      rays_.near_m[to] = rays.near_m == nullptr ? kNearM : rays.near_m[first + i];
      rays_.range_m[to] = range_m[first + i];
      rays_.face[to] = -1;
      rays_.place[to] = static_cast<std::uint32_t>(first + i);
      reach_m_ = std::max(reach_m_, range_m[first + i]);
    }
    for (CubeSide& side : sides_) {
      if (side.count > 0) side.count_rays();
    }
  }

  // Triangles by their tangents, on one side of the cube.
  struct Shapes {
    float across[3][kSize], up[3][kSize];
    float low[2][kSize], high[2][kSize];
    std::int32_t row[2][kSize];  // of cells, first and last
    std::int32_t rays[kSize];    // in the cells about it; many for one that needs clipping
    std::int32_t steep[kSize];   // needs clipping
  };

  MAPPERD_VECTORISED static void set_shapes(const Facets& facets, const CubeSide& side,
                                            Shapes& to) {
    for (std::size_t i = 0; i < kSize; ++i) {
      std::int32_t steep = 0;
      float low[2] = {kInfinite, kInfinite}, high[2] = {-kInfinite, -kInfinite};
      for (std::size_t k = 0; k < 3; ++k) {
        const Point<float> p = side.corner(facets, k, i);
        const float wide = std::max(std::fabs(p.across), std::fabs(p.up));
        steep |= static_cast<std::int32_t>(!(kSteep * p.ahead > wide));
        const float across = p.across / p.ahead, up = p.up / p.ahead;
        to.across[k][i] = across;
        to.up[k][i] = up;
        low[0] = std::min(low[0], across);
        high[0] = std::max(high[0], across);
        low[1] = std::min(low[1], up);
        high[1] = std::max(high[1], up);
      }
      to.steep[i] = steep;
      for (std::size_t k = 0; k < 2; ++k) {
        to.low[k][i] = low[k];
        to.high[k][i] = high[k];
      }
    }
  }

  // False if no ray is near any of them.
  MAPPERD_VECTORISED static bool set_cells(const CubeSide& side, Shapes& to) {
    const float low_across = side.low[0], low_up = side.low[1];
    const float high_across = side.high[0] + kSlack, high_up = side.high[1] + kSlack;
    const float per_across = side.scale[0], per_up = side.scale[1];
    const auto last_cell = static_cast<float>(side.cells - 1);
    const auto last_row = static_cast<float>(side.rows - 1);
    const std::int32_t* __restrict before = side.before.data();
    const auto line = static_cast<std::int32_t>(side.cells + 1);
    std::int32_t some = 0;
    MAPPERD_INDEPENDENT
    for (std::size_t i = 0; i < kSize; ++i) {
      const float from = to.low[0][i] - kSlack, until = to.high[0][i] + kSlack;
      const float under = to.low[1][i] - kSlack, over = to.high[1][i] + kSlack;
      const std::int32_t first = clamped((from - low_across) * per_across, last_cell);
      const std::int32_t last = clamped((until - low_across) * per_across, last_cell) + 1;
      const std::int32_t low_row = clamped((under - low_up) * per_up, last_row);
      const std::int32_t high_row = clamped((over - low_up) * per_up, last_row);
      const std::int32_t bottom = low_row * line, top = (high_row + 1) * line;
      const std::int32_t rays =
          before[top + last] - before[top + first] - before[bottom + last] + before[bottom + first];
      const std::int32_t seen = (from <= high_across ? 1 : 0) & (until >= low_across ? 1 : 0) &
                                (under <= high_up ? 1 : 0) & (over >= low_up ? 1 : 0);
      const std::int32_t near = to.steep[i] != 0 ? kFewRays + 1 : rays * seen;
      to.row[0][i] = low_row;
      to.row[1][i] = high_row;
      to.rays[i] = near;
      some |= near;
    }
    return some != 0;
  }

  // Of a cell or row; 0 for NaN.
  MAPPERD_INLINE static std::int32_t clamped(float at, float last) {
    const float positive = at > 0.0F ? at : 0.0F;
    return static_cast<std::int32_t>(positive < last ? positive : last);
  }

  // A convex polygon of tangents.
  struct Polygon {
    std::size_t count = 0;
    float at[kMaxCorners][2];
    float low[2] = {kInfinite, kInfinite}, high[2] = {-kInfinite, -kInfinite};

    void add(float across, float up) {
      const float tangent[2] = {across, up};
      for (std::size_t k = 0; k < 2; ++k) {
        at[count][k] = tangent[k];
        low[k] = std::min(low[k], tangent[k]);
        high[k] = std::max(high[k], tangent[k]);
      }
      ++count;
    }
  };

  // Clips a triangle to the view frustum of a side; false if nothing is left. In double
  // precision: a large triangle may pass by the origin closely.
  static bool clip(const Facets& facets, std::size_t i, const CubeSide& side, Polygon& polygon) {
    std::array<Point<double>, kMaxCorners> from, to;
    for (std::size_t k = 0; k < 3; ++k) {
      const Point<float> p = side.corner(facets, k, i);
      from[k] = {static_cast<double>(p.across), static_cast<double>(p.up),
                 static_cast<double>(p.ahead)};
    }
    std::size_t count = 3;
    for (std::size_t plane = 0; plane < 4; ++plane) {
      std::size_t kept = 0;
      for (std::size_t k = 0; k < count; ++k) {
        const Point<double>& a = from[k];
        const Point<double>& b = from[(k + 1) % count];
        const double da = side.depth(plane, a), db = side.depth(plane, b);
        if (da >= 0.0) to[kept++] = a;
        if ((da < 0.0) != (db < 0.0)) {
          const double part = da / (da - db);
          to[kept++] = {a.across + part * (b.across - a.across), a.up + part * (b.up - a.up),
                        a.ahead + part * (b.ahead - a.ahead)};
        }
      }
      count = kept;
      if (count == 0) return false;
      from = to;
    }
    for (std::size_t k = 0; k < count; ++k) {
      const Point<double>& p = from[k];
      if (!(p.ahead > kClosest)) {  // any ray may meet it
        polygon = Polygon{};
        polygon.add(side.low[0], side.low[1]);
        polygon.add(side.high[0], side.low[1]);
        polygon.add(side.high[0], side.high[1]);
        polygon.add(side.low[0], side.high[1]);
        return true;
      }
      polygon.add(static_cast<float>(p.across / p.ahead), static_cast<float>(p.up / p.ahead));
    }
    return true;
  }

  MAPPERD_VECTORISED static void test_triangles(const Facets& facets, const Shapes& shapes,
                                                const std::int32_t* indices,
                                                std::int32_t first_face, const CubeSide& side,
                                                SortedRays& rays) {
    for (std::size_t i = 0; i < kSize; ++i) {
      if (shapes.rays[i] == 0) continue;
      Polygon polygon;
      auto low_row = static_cast<std::size_t>(shapes.row[0][i]);
      auto high_row = static_cast<std::size_t>(shapes.row[1][i]);
      if (shapes.steep[i] != 0) {
        if (!clip(facets, i, side, polygon)) continue;
        low_row = side.cell(1, polygon.low[1] - kSlack);
        high_row = side.cell(1, polygon.high[1] + kSlack);
      } else {
        polygon.count = 3;
        for (std::size_t k = 0; k < 3; ++k) {
          polygon.at[k][0] = shapes.across[k][i];
          polygon.at[k][1] = shapes.up[k][i];
        }
        for (std::size_t k = 0; k < 2; ++k) {
          polygon.low[k] = shapes.low[k][i];
          polygon.high[k] = shapes.high[k][i];
        }
      }
      const std::int32_t face = indices[i] + first_face;
      for (std::size_t row = low_row; row <= high_row; ++row) {
        float from = polygon.low[0], to = polygon.high[0];
        if (low_row < high_row && shapes.rays[i] > kFewRays) {
          const float bottom = side.low[1] + static_cast<float>(row) / side.scale[1] - kSlack;
          const float top = side.low[1] + static_cast<float>(row + 1) / side.scale[1] + kSlack;
          const bool lowest = row == 0, highest = row + 1 == side.rows;
          if (!part_between(polygon, lowest ? -kInfinite : bottom, highest ? kInfinite : top, from,
                            to)) {
            continue;
          }
        }
        if (from > side.high[0] + kSlack || to < side.low[0] - kSlack) continue;
        const std::size_t line = row * side.cells;
        const std::size_t begin = side.first[line + side.cell(0, from - kSlack)];
        const std::size_t end = side.first[line + side.cell(0, to + kSlack) + 1];
        for (std::size_t at = begin; at < end; at += kLanes) try_rays(facets, i, face, rays, at);
      }
    }
  }

  // Extent across of a polygon between two tangents up; false if it lies outside them.
  MAPPERD_INLINE static bool part_between(const Polygon& polygon, float bottom, float top,
                                          float& from, float& to) {
    from = kInfinite;
    to = -kInfinite;
    for (std::size_t k = 0; k < polygon.count; ++k) {
      const float* a = polygon.at[k];
      const float* b = polygon.at[k + 1 < polygon.count ? k + 1 : 0];
      if (std::max(a[1], b[1]) < bottom || std::min(a[1], b[1]) > top) continue;
      const float slope = (b[0] - a[0]) / (b[1] - a[1]);
      for (const float* end : {a, b}) {
        float across = end[0];
        if (end[1] < bottom) across += (bottom - end[1]) * slope;
        if (end[1] > top) across += (top - end[1]) * slope;
        from = std::min(from, across);
        to = std::max(to, across);
      }
    }
    return from <= to;
  }

  MAPPERD_INLINE static void try_rays(const Facets& facets, std::size_t facet, std::int32_t index,
                                      SortedRays& rays, std::size_t first) {
    const float* x = rays.x.data() + first;
    const float* y = rays.y.data() + first;
    const float* z = rays.z.data() + first;
    const float* near_m = rays.near_m.data() + first;
    float* range_m = rays.range_m.data() + first;
    std::int32_t* face = rays.face.data() + first;
    const float height = facets.height[facet];
    for (std::size_t i = 0; i < kLanes; ++i) {
      const auto along = [&](const auto& n) {
        return n[0][facet] * x[i] + n[1][facet] * y[i] + n[2][facet] * z[i];
      };
      const float inside =
          std::min(std::min(along(facets.edge_normal[0]), along(facets.edge_normal[1])),
                   along(facets.edge_normal[2]));
      const float t = height / along(facets.normal);
      // Of triangles at one range the lowest: rays may be tried twice, and in any order.
      const bool nearer = (t < range_m[i]) | ((t == range_m[i]) & (index < face[i]));
      const bool hit = (inside >= -kOverlap) & (t > near_m[i]) & nearer;
      range_m[i] = hit ? t : range_m[i];
      face[i] = hit ? index : face[i];
    }
  }

  std::size_t count_;
  double origin_m_[3];
  float reach_m_ = 0.0F;
  SortedRays rays_;
  std::vector<CubeSide> sides_;
};

}  // namespace

std::vector<TrianglePack> pack_triangles(const float* corners_m, std::size_t count) {
  std::vector<float> middles;
  middles.reserve(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    const float* c = corners_m + 9 * i;
    for (std::size_t k = 0; k < 3; ++k) middles.push_back((c[k] + c[3 + k] + c[6 + k]) / 3.0F);
  }
  const std::vector<std::uint32_t> order = morton_order(middles.data(), count);
  std::vector<TrianglePack> packs;
  packs.reserve((count + kSize - 1) / kSize);
  for (std::size_t first = 0; first < count; first += kSize) {
    TrianglePack pack;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      float low = kInfinite, high = -kInfinite;
      for (std::size_t i = 0; i < kSize; ++i) {
        const bool real = first + i < count;
        const std::size_t from = order[real ? first + i : first];
        pack.index[i] = static_cast<std::int32_t>(from);
        for (std::size_t k = 0; k < 3; ++k) {
          const float at = corners_m[9 * from + 3 * (real ? k : 0) + axis];
          pack.corner_m[k][axis][i] = at;
          low = std::min(low, at);
          high = std::max(high, at);
        }
      }
      pack.middle_m[axis] = low + 0.5F * (high - low);
      // A little more, as the middle is rounded.
      const float half = std::max(high - pack.middle_m[axis], pack.middle_m[axis] - low);
      pack.half_m[axis] = half * (1.0F + kSlack);
    }
    packs.push_back(pack);
  }
  return packs;
}

void cast_bundle(const std::vector<TrianglePack>& mesh, const RayBundle& rays,
                 std::int32_t first_face, unsigned threads, float* range_m, std::int32_t* face) {
  const std::size_t max_parts = std::max<std::size_t>(rays.count / kRaysPerThread, 1);
  const std::size_t parts = std::min<std::size_t>(std::max(threads, 1U), max_parts);
  run_parallel(parts, static_cast<int>(parts), [&](std::size_t part) {
    const std::size_t first = rays.count * part / parts;
    const std::size_t last = rays.count * (part + 1) / parts;
    Bundle bundle(rays, range_m, first, last);
    bundle.intersect(mesh, first_face);
    bundle.write_hits(range_m, face);
  });
}

MAPPERD_VECTORISED void multiply_rows(const float* __restrict rows, std::size_t count,
                                      const std::array<float, 9>& matrix, float* __restrict to) {
  const float xx = matrix[0], xy = matrix[1], xz = matrix[2];
  const float yx = matrix[3], yy = matrix[4], yz = matrix[5];
  const float zx = matrix[6], zy = matrix[7], zz = matrix[8];
  for (std::size_t i = 0; i < count; ++i) {
    const float x = rows[3 * i], y = rows[3 * i + 1], z = rows[3 * i + 2];
    to[3 * i] = x * xx + y * yx + z * zx;
    to[3 * i + 1] = x * xy + y * yy + z * zy;
    to[3 * i + 2] = x * xz + y * yz + z * zz;
  }
}

void meet_sea(const RayBundle& rays, const SeaSurface& sea, float* range_m, std::int32_t* face,
              std::int32_t* group) {
  if (!(sea.above_m > 0.0)) return;
  for (std::size_t i = 0; i < rays.count; ++i) {
    const float rise = rays.direction[3 * i + 2];
    if (!(rise > 0.0F)) continue;
    const auto at_m = static_cast<float>(sea.above_m / std::max(static_cast<double>(rise), 1e-9));
    if (!(at_m < range_m[i]) || (rays.near_m != nullptr && !(at_m > rays.near_m[i]))) continue;
    range_m[i] = at_m;
    face[i] = sea.face;
    group[i] = sea.group;
  }
}

std::vector<std::int64_t> rays_near_ball(std::size_t count, const double* start_m,
                                         const float* direction, double reach_m,
                                         const double* middle_m, double radius_m) {
  std::vector<std::int64_t> near;
  for (std::size_t i = 0; i < count; ++i) {
    double away[3], along = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      away[k] = middle_m[k] - start_m[3 * i + k];
      along += away[k] * static_cast<double>(direction[3 * i + k]);
    }
    along = std::clamp(along, 0.0, reach_m);
    double square = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      const double gap = away[k] - along * static_cast<double>(direction[3 * i + k]);
      square += gap * gap;
    }
    if (!(square > radius_m * radius_m)) near.push_back(static_cast<std::int64_t>(i));
  }
  return near;
}

std::vector<double> visible_points(const SeenRays& rays, double range_m, double bearing_sine,
                                   double elevation_sine) {
  std::vector<double> points;
  points.reserve(3 * rays.count);
  for (std::size_t i = 0; i < rays.count; ++i) {
    const auto reach_m = static_cast<double>(rays.range_m[i]);
    if (rays.face[i] < 0 || !(reach_m < range_m)) continue;
    if (std::fabs(static_cast<double>(rays.direction[3 * i + 1])) > bearing_sine) continue;
    if (std::fabs(static_cast<double>(rays.direction[3 * i + 2])) > elevation_sine) continue;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      points.push_back(rays.origin_m[axis] +
                       reach_m * static_cast<double>(rays.map_direction[3 * i + axis]));
    }
  }
  return points;
}

namespace {

// Marks the cells of which a direction may pass through a window.
MAPPERD_VECTORISED void mark_through(const FanDirections& fan, const MirrorWindow& window,
                                     std::int32_t* __restrict through) {
  // Cells that reach nearer to the plane across the sonar than this sine are curved.
  constexpr double kMinAhead = 0.1;
  const Vec3& o = window.map_T_fan.translation;
  const std::array<Vec3, 3>& rows = window.map_T_fan.rows;
  const Vec3 n = window.map_T_fan.rotate_back(window.normal);
  const double nx = n.x, ny = n.y, nz = n.z;
  const double height_m = window.height_m, reach_m = window.reach_m;
  const double row[9] = {rows[0].x, rows[0].y, rows[0].z, rows[1].x, rows[1].y,
                         rows[1].z, rows[2].x, rows[2].y, rows[2].z};
  const double origin[3] = {o.x, o.y, o.z};
  const double low_m[3] = {window.low_m.x, window.low_m.y, window.low_m.z};
  const double high_m[3] = {window.high_m.x, window.high_m.y, window.high_m.z};
  const float* __restrict direction = fan.direction;
  const float* __restrict cell = fan.cell;
  for (std::size_t i = 0; i < fan.count; ++i) {
    const double x = static_cast<double>(direction[3 * i]);
    const double y = static_cast<double>(direction[3 * i + 1]);
    const double z = static_cast<double>(direction[3 * i + 2]);
    const double half_s = 0.5 * static_cast<double>(cell[4 * i + 1] - cell[4 * i]);
    const double half_w = 0.5 * static_cast<double>(cell[4 * i + 3] - cell[4 * i + 2]);
    const double far_s = std::fabs(y) + half_s;
    const double far_w = std::fabs(z) + half_w;
    const double ahead2 = 1.0 - far_s * far_s - far_w * far_w;
    // How far a direction of the cell may be from its middle.
    const double least = ahead2 > 1e-9 ? ahead2 : 1e-9;
    const double off = std::sqrt((half_s * half_s + half_w * half_w) / least);
    const double cosine = nx * x + ny * y + nz * z;
    const bool curved = ahead2 < kMinAhead * kMinAhead;
    const bool grazing = cosine <= 2.0 * off;
    const bool ahead = cosine >= -2.0 * off;
    // It crosses the plane within this margin of where the middle does.
    const double crossing_m = height_m / cosine;
    const double margin_m = window.margin_m + 4.0 * crossing_m * off / cosine;
    bool inside = height_m < reach_m * (cosine + off);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double at = origin[axis] + crossing_m * (row[3 * axis] * x + row[3 * axis + 1] * y +
                                                     row[3 * axis + 2] * z);
      inside &= (at > low_m[axis] - margin_m) & (at < high_m[axis] + margin_m);
    }
    through[i] = static_cast<std::int32_t>(curved | (ahead & (grazing | inside)));
  }
}

}  // namespace

std::vector<std::int64_t> cells_through_window(const FanDirections& fan,
                                               const MirrorWindow& window) {
  std::vector<std::int32_t> through(fan.count);
  mark_through(fan, window, through.data());
  std::vector<std::int64_t> kept;
  kept.reserve(fan.count);
  for (std::size_t i = 0; i < fan.count; ++i) {
    if (through[i] != 0) kept.push_back(static_cast<std::int64_t>(i));
  }
  return kept;
}

}  // namespace mapperd::acoustics
