#include "mapperd/map/voxel_integral.hpp"

#include <algorithm>
#include <cmath>

namespace mapperd::map {
namespace {

constexpr double kConeTolerance = 1e-4;  // of a voxel's edge
constexpr double kThroughFoot = 1e-12;   // m: an edge through the foot carries nothing

struct Point {
  double u;
  double v;
};

// A convex polygon in the plane of a face; four planes cut a square to at most eight corners.
struct Polygon {
  std::array<Point, 12> points;
  std::size_t count = 0;
};

// Keeps the side of the line a u + b v + c >= 0 (Sutherland and Hodgman, CACM 17, 1974).
void clip(Polygon& polygon, double a, double b, double c) {
  std::array<double, 12> side;
  bool any_out = false;
  bool any_in = false;
  for (std::size_t i = 0; i < polygon.count; ++i) {
    side[i] = a * polygon.points[i].u + b * polygon.points[i].v + c;
    any_out = any_out || side[i] < 0;
    any_in = any_in || side[i] >= 0;
  }
  if (!any_out) return;
  if (!any_in) {
    polygon.count = 0;
    return;
  }
  Polygon kept;
  for (std::size_t i = 0; i < polygon.count; ++i) {
    const std::size_t next = i + 1 == polygon.count ? 0 : i + 1;
    const Point& p = polygon.points[i];
    const Point& q = polygon.points[next];
    if (side[i] >= 0) kept.points[kept.count++] = p;
    if ((side[i] >= 0) != (side[next] >= 0)) {
      const double k = side[i] / (side[i] - side[next]);
      kept.points[kept.count++] = {p.u + k * (q.u - p.u), p.v + k * (q.v - p.v)};
    }
  }
  polygon = kept;
}

// atan(y / x) for x >= 0. Most edges are short as seen from the foot: there the series, with the
// library function's precision, spares its range reduction.
double angle_of(double y, double x) {
  const double q = y / x;
  if (!(std::abs(q) < 0.1)) return std::atan2(y, x);
  const double s = q * q;
  return q *
         (1 + s * (-1.0 / 3 +
                   s * (1.0 / 5 +
                        s * (-1.0 / 7 +
                             s * (1.0 / 9 + s * (-1.0 / 11 + s * (1.0 / 13 - s * (1.0 / 15))))))));
}

// A point of an edge's line: t along it, and its range.
struct EdgePoint {
  double r;
  double t;
};

// One edge of a clipped face: its share of the face's flux.
class Edge {
 public:
  Edge() = default;
  Edge(const Point& from, const Point& to, double distance) : distance_(distance) {
    const double du = to.u - from.u;
    const double dv = to.v - from.v;
    const double length = std::sqrt(du * du + dv * dv);
    if (!(length > 0)) return;
    const double inverse = 1.0 / length;
    offset_ = (from.u * dv - from.v * du) * inverse;
    from_ = (from.u * du + from.v * dv) * inverse;
    to_ = from_ + length;
    foot_squared_ = distance * distance + offset_ * offset_;
  }

  // Signed distance from the foot: positive when the polygon runs counter-clockwise around it.
  double offset() const { return offset_; }
  bool carries() const { return std::abs(offset_) > kThroughFoot; }
  // The edge as seen from the foot.
  double angle() const { return std::atan2(to_, offset_) - std::atan2(from_, offset_); }

  void add(const RadialProfile& profile, Two& sum) const {
    // Range is monotonic on either side of the edge's own foot.
    if (from_ < 0) add_monotonic(profile, std::min(to_, 0.0), from_, -1.0, sum);
    if (to_ > 0) add_monotonic(profile, std::max(from_, 0.0), to_, 1.0, sum);
  }

 private:
  EdgePoint point_at_range(double r, double side) const {
    return {r, side * std::sqrt(std::max(r * r - foot_squared_, 0.0))};
  }

  // From t_in (nearer to the sonar) to t_out.
  void add_monotonic(const RadialProfile& profile, double t_in, double t_out, double side,
                     Two& sum) const {
    const EdgePoint end{std::sqrt(t_out * t_out + foot_squared_), t_out};
    if (end.r <= profile.start_m()) return;
    EdgePoint a{std::sqrt(t_in * t_in + foot_squared_), t_in};
    if (a.r < profile.start_m()) a = point_at_range(profile.start_m(), side);
    for (std::size_t i = profile.index_at(a.r);; ++i) {
      const bool last = i + 1 == profile.count() || profile.piece(i + 1).near_m >= end.r;
      const EdgePoint b = last ? end : point_at_range(profile.piece(i + 1).near_m, side);
      add_piece(profile.piece(i), a, b, side, sum);
      if (last) return;
      a = b;
    }
  }

  // Differences of the closed form's angles, as angles of quotients: atan p - atan q =
  // atan((p - q) / (1 + p q)), with t on one side of the edge's foot and so p q >= 0.
  void add_piece(const RadialPiece& piece, const EdgePoint& a, const EdgePoint& b, double side,
                 Two& sum) const {
    const double tt = a.t * b.t;
    const double rr = a.r * b.r;
    const double theta = distance_ * side * angle_of(offset_ * (b.t - a.t), offset_ * offset_ + tt);
    const double psi = side * angle_of(distance_ * offset_ * (b.t * a.r - a.t * b.r),
                                       offset_ * offset_ * rr + distance_ * distance_ * tt);
    const double along = distance_ * side * offset_ * (b.t - a.t);
    const double sixth = (along + distance_ * distance_ * theta) / 6;
    sum.part += piece.offset.part * theta + piece.value.part * sixth - piece.flux.part * psi;
    sum.weight +=
        piece.offset.weight * theta + piece.value.weight * sixth - piece.flux.weight * psi;
  }

  double distance_ = 0.0;
  double offset_ = 0.0;
  double from_ = 0.0;
  double to_ = 0.0;
  double foot_squared_ = 0.0;
};

// A wedge between two bearing planes, bounded above and below where the aperture cuts the cube.
struct Wedge {
  std::array<Vec3, 4> normals;  // pointing inwards, through the sonar
  std::size_t count = 0;
};

double component(const Vec3& v, std::size_t axis) {
  return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}

// A face's plane: its distance from the sonar, and axes in it from the foot of the perpendicular.
struct Plane {
  Vec3 normal;
  Vec3 u;
  Vec3 v;
  double distance;
};

void clip(Polygon& polygon, const Plane& plane, const Wedge& wedge) {
  for (std::size_t i = 0; i < wedge.count && polygon.count > 0; ++i) {
    const Vec3& n = wedge.normals[i];
    clip(polygon, dot(n, plane.u), dot(n, plane.v), dot(n, plane.normal) * plane.distance);
  }
}

Polygon clipped_face(const Cube& cube, const Wedge& wedge, std::size_t axis, double distance) {
  const std::size_t u = (axis + 1) % 3;
  const std::size_t v = (axis + 2) % 3;
  const double h = cube.half_m;
  const double cu = cube.centre_m[u];
  const double cv = cube.centre_m[v];
  Polygon face;
  face.points[0] = {cu - h, cv - h};
  face.points[1] = {cu + h, cv - h};
  face.points[2] = {cu + h, cv + h};
  face.points[3] = {cu - h, cv + h};
  face.count = 4;
  for (std::size_t i = 0; i < wedge.count && face.count > 0; ++i) {
    const Vec3& n = wedge.normals[i];
    clip(face, component(n, u), component(n, v), component(n, axis) * distance);
  }
  return face;
}

Two flux_through(const Polygon& face, double distance, const RadialProfile& profile) {
  Two flux;
  double turn = 0.0;
  bool around_foot = true;
  std::array<Edge, 12> carrying;
  std::size_t count = 0;
  for (std::size_t i = 0; i < face.count; ++i) {
    const Edge edge(face.points[i], face.points[i + 1 == face.count ? 0 : i + 1], distance);
    if (!edge.carries()) continue;
    edge.add(profile, flux);
    around_foot = around_foot && edge.offset() > 0;
    carrying[count++] = edge;
  }
  // D counts from the foot on, which matters to a polygon around the foot or with it on its rim.
  if (!around_foot) return flux;
  for (std::size_t i = 0; i < count; ++i) turn += carrying[i].angle();
  const Two foot = profile.potential(std::abs(distance));
  return {flux.part - distance * turn * foot.part, flux.weight - distance * turn * foot.weight};
}

// Squared distance of a face's farthest corner.
double farthest(const Cube& cube, std::size_t axis, double distance) {
  const double u = std::abs(cube.centre_m[(axis + 1) % 3]) + cube.half_m;
  const double v = std::abs(cube.centre_m[(axis + 2) % 3]) + cube.half_m;
  return distance * distance + u * u + v * v;
}

// Flux out of the faces of what a moving sonar sees, inside the wedge.
void add_seen_wedge(const Cube& cube, const Wedge& wedge, const RadialProfile& profile, Two& sum) {
  const std::array<Vec3, 3> edge{cube.half_m * cube.seen->x, cube.half_m * cube.seen->y,
                                 cube.half_m * cube.seen->z};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const Vec3& along_u = edge[(axis + 1) % 3];
    const Vec3& along_v = edge[(axis + 2) % 3];
    const Vec3 square = cross(along_u, along_v);
    Plane plane;
    plane.normal = (1.0 / norm(square)) * square;
    plane.u = (1.0 / norm(along_u)) * along_u;
    plane.v = cross(plane.normal, plane.u);
    for (const double outward : {-1.0, 1.0}) {
      const Vec3 middle = cube.centre() + outward * edge[axis];
      plane.distance = dot(plane.normal, middle);
      const auto corner = [&](double u, double v) {
        const Vec3 at = middle + (u * along_u + v * along_v);
        return Point{dot(plane.u, at), dot(plane.v, at)};
      };
      Polygon face;
      face.points = {corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)};
      face.count = 4;
      clip(face, plane, wedge);
      if (face.count < 3) continue;
      const Two flux = flux_through(face, plane.distance, profile);
      sum.part += outward * flux.part;
      sum.weight += outward * flux.weight;
    }
  }
}

// Flux out of the cube's faces, inside the wedge.
void add_wedge(const Cube& cube, const Wedge& wedge, const RadialProfile& profile, Two& sum) {
  if (cube.seen != nullptr) return add_seen_wedge(cube, wedge, profile, sum);
  // Before the first evidence there is no flux.
  const double start_squared = profile.start_m() * profile.start_m();
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (const double outward : {-1.0, 1.0}) {
      const double distance = cube.centre_m[axis] + outward * cube.half_m;
      if (farthest(cube, axis, distance) <= start_squared) continue;
      const Polygon face = clipped_face(cube, wedge, axis, distance);
      if (face.count < 3) continue;
      const Two flux = flux_through(face, distance, profile);
      sum.part += outward * flux.part;
      sum.weight += outward * flux.weight;
    }
  }
}

// Where a cube lies as a plane through the sonar sees it.
enum class Side { inside, across, outside };

Side side_of(const Cube& cube, const Vec3& inwards) {
  const double at = dot(inwards, cube.centre());
  const Vec3 n = cube.of_place(inwards);
  const double reach = cube.half_m * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z));
  if (at <= -reach) return Side::outside;
  return at >= reach ? Side::inside : Side::across;
}

// The beam as one wedge, or as several where the aperture's cone bends too much inside it.
void add_beam(const Fan& fan, std::size_t beam, const Cube& cube, const FanPart& where,
              const RadialProfile& profile, Two& sum) {
  if (!where.cut_by_aperture) {
    Wedge wedge;
    for (const Vec3& inwards : {fan.edge_normal(beam), -1.0 * fan.edge_normal(beam + 1)}) {
      const Side side = side_of(cube, inwards);
      if (side == Side::outside) return;
      if (side == Side::across) wedge.normals[wedge.count++] = inwards;
    }
    return add_wedge(cube, wedge, profile, sum);
  }
  const double from = fan.edges_rad()[beam];
  const double width = fan.edges_rad()[beam + 1] - from;
  // Over a wedge of width b the cone leaves its mean plane by up to z b^2 / 12.
  const double height = where.far_m * fan.sin_half_aperture();
  const double allowed = std::sqrt(12 * kConeTolerance * 2 * cube.half_m / height);
  const int parts = static_cast<int>(std::ceil(std::min(width / allowed, 1000.0)));
  for (int i = 0; i < parts; ++i) {
    const double low = from + width * i / parts;
    const double high = from + width * (i + 1) / parts;
    Wedge wedge{{fan.normal_at(low), -1.0 * fan.normal_at(high)}, 4};
    fan.aperture_planes(low, high, wedge.normals[2], wedge.normals[3]);
    add_wedge(cube, wedge, profile, sum);
  }
}

double volume_of(const Cube& cube) {
  const double volume = 8 * cube.half_m * cube.half_m * cube.half_m;
  return cube.seen != nullptr ? volume * cube.seen->volume() : volume;
}

}  // namespace

Two occupied_part(const Fan& fan, const Cube& cube, const FanPart& where) {
  Two sum;
  for (std::size_t j = where.first_beam; j <= where.last_beam; ++j) {
    // Without a return in the cube's range C is constant there, and a constant has no net flux.
    if (fan.any_return(j, j, where.near_m, where.far_m)) {
      add_beam(fan, j, cube, where, fan.returns(j), sum);
    }
  }
  const double volume = volume_of(cube);
  return {sum.part / volume, sum.weight / volume};
}

double free_part(const Fan& fan, const Cube& cube, const FanPart& where) {
  Two sum;
  for (std::size_t j = where.first_beam; j <= where.last_beam; ++j) {
    const RadialProfile& profile = fan.free_space(j);
    if (!profile.empty() && where.near_m < profile.end_m()) {
      add_beam(fan, j, cube, where, profile, sum);
    }
  }
  return sum.part / volume_of(cube);
}

}  // namespace mapperd::map
