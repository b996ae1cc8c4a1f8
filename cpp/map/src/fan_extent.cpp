// How far a cube reaches as the fan sees it.
#include <algorithm>
#include <array>
#include <cmath>

#include "mapperd/map/fan.hpp"

namespace mapperd::map {
namespace {

const double kHalfDiagonal = std::sqrt(3.0) / 2;  // of a unit cube

// How deep a slice off the corner of a unit cube may be, along a direction that is known to `turn`,
// to hold less than `part` of it. The slice is part of a tetrahedron, of a prism over a triangle,
// and of a slab; whichever bounds its volume best.
double cap_depth(const Vec3& direction, double turn, double part) {
  std::array<double, 3> width{std::abs(direction.x), std::abs(direction.y), std::abs(direction.z)};
  std::sort(width.begin(), width.end());
  for (double& w : width) w = std::max(w - turn, 0.0);
  return std::max({std::cbrt(6 * width[0] * width[1] * width[2] * part),
                   std::sqrt(2 * width[1] * width[2] * part), width[2] * part});
}

double level_of(const Fan::Extent& extent) {
  return std::max(extent.sideways, extent.forward) * 1.4142135623730951;
}

// Bearings within atan(t) <= t of one whose cosine is known: sin(b + t) - sin(b) is at most
// t cos(b) + t^2 / 2.
double spread_of(const Fan::Extent& extent, double horizontal, double cosine) {
  constexpr double kAnyBearing = 2.0;
  const double nearest = horizontal - extent.forward;
  if (!(nearest > 0)) return kAnyBearing;
  const double t = extent.sideways / nearest;
  return std::min(t * cosine + 0.5 * t * t, kAnyBearing);
}

}  // namespace

// Beside the sonar directions change within the cube: the ball around it.
Fan::Extent Fan::ball(double radius, double horizontal) {
  Extent extent{radius, radius, radius, radius, radius, radius, 0.0, 0.0, 0.0, 0.0, 0.0};
  extent.level = level_of(extent);
  extent.spread = spread_of(extent, horizontal, 1.0);
  return extent;
}

// What a moving sonar sees of a cube lies in a larger one; surfaces that were bent are bent more.
double Fan::seen_edge(double edge_m, const Widening& widening) {
  return edge_m * (1 + 2 * kHalfDiagonal * widening.stretch) + 2 * widening.bend;
}

void Fan::widen(Extent& extent, const Widening& widening) {
  extent.warp = 2 * widening.bend;
  extent.outward += extent.warp;
  extent.bend += extent.warp;
}

// Support widths of the cube, plus what the curvature of spheres and cones adds.
Fan::Extent Fan::extent_of(const Vec3& in_sonar, double edge_m, const Widening& widening) const {
  Extent extent = extent_at_rest(in_sonar, seen_edge(edge_m, widening));
  widen(extent, widening);
  return extent;
}

Fan::Extent Fan::extent_at_rest(const Vec3& in_sonar, double edge_m) const {
  const double radius = kHalfDiagonal * edge_m;
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  if (horizontal < 2 * radius) return ball(radius, horizontal);
  const auto width = [&](const Vec3& direction) {
    const Vec3 d = rotation_.rotate(direction);
    return 0.5 * edge_m * (std::abs(d.x) + std::abs(d.y) + std::abs(d.z));
  };
  const Vec3 ahead{in_sonar.x / horizontal, in_sonar.y / horizontal, 0.0};
  // The square to the nearer of the aperture's cones, as it is in the centre's half-plane.
  const double up = std::copysign(cos_half_, in_sonar.z);
  const Vec3 across_cone{-ahead.x * sin_half_, -ahead.y * sin_half_, up};
  // A horizontal offset d to the side lengthens the distance from the vertical axis by d^2 / 2.
  const double bend = radius * radius / (2 * (horizontal - radius));
  Extent extent{};
  extent.inward = width((1.0 / norm(in_sonar)) * in_sonar);
  extent.outward = extent.inward + bend;
  extent.sideways = width({-ahead.y, ahead.x, 0.0});
  extent.forward = width(ahead) + bend;
  extent.bend = bend * sin_half_;
  extent.aperture = width(across_cone) + extent.bend;
  // Both cones cross a cube where the fan is thin: the centre decides nothing there.
  if (horizontal * sin_half_ < 2 * radius) extent.bend = extent.aperture = radius;
  extent.level = level_of(extent);
  extent.spread = spread_of(extent, horizontal, std::abs(in_sonar.x) / horizontal);
  return extent;
}

Fan::Verdict Fan::verdict(const Vec3& centre, double edge_m) const {
  if (view_) {
    return verdict(view_->look(centre), view_->widening(centre, kHalfDiagonal * edge_m), edge_m);
  }
  return verdict(centre, place_of(centre), extent_of(to_sonar(centre), edge_m));
}

Fan::Verdict Fan::verdict(const Seen& seen, const Widening& widening, double edge_m) const {
  return verdict(seen.at, place_of(seen.at), extent_of(to_sonar(seen.at), edge_m, widening),
                 &seen.axes);
}

Fan::Place Fan::place_of(const Vec3& centre) const {
  const Vec3 in_sonar = to_sonar(centre);
  Place place{};
  place.horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  place.range = norm(centre);
  place.sine = place.horizontal > 0 ? -in_sonar.y / place.horizontal : 0.0;
  place.inside_aperture = place.horizontal * sin_half_ - std::abs(in_sonar.z) * cos_half_;
  place.inside_sides =
      std::min(dot(edge_normals_.front(), centre), -dot(edge_normals_.back(), centre));
  return place;
}

Fan::Extent Fan::extent_in_cell(const Vec3& in_sonar, double edge_m, int cell,
                                const Widening& widening) const {
  Extent extent = extent_in_cell_at_rest(in_sonar, seen_edge(edge_m, widening), cell);
  widen(extent, widening);
  if (!(extent.edge > 0)) return extent;
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  const double reach = kHalfDiagonal * extent.edge * cell;
  const double turn = reach / (horizontal - reach) + widening.stretch;
  const Vec3 direction = rotation_.rotate((1.0 / norm(in_sonar)) * in_sonar);
  extent.cap = std::max(cap_depth(direction, turn, kNegligiblePart) * edge_m - extent.warp, 0.0);
  extent.edge = edge_m;
  return extent;
}

Fan::Extent Fan::extent_in_cell_at_rest(const Vec3& in_sonar, double edge_m, int cell) const {
  const double reach = kHalfDiagonal * edge_m * cell;
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  const double radius = kHalfDiagonal * edge_m;
  if (horizontal < 4 * reach) return ball(radius, horizontal - reach);
  Extent extent = extent_at_rest(in_sonar, edge_m);
  // Unit directions turn by at most reach / distance within the cell, support widths change by at
  // most the cube's radius times that.
  const double turn = radius * reach / (horizontal - reach);
  const double bend = radius * radius / (2 * (horizontal - reach - radius));
  extent.inward += turn;
  extent.outward = extent.inward + bend;
  extent.sideways += turn;
  extent.forward += turn + bend;
  extent.bend = bend * sin_half_;
  // A cell around the fan's middle plane meets both cones, and their directions.
  if (std::abs(in_sonar.z) < reach) {
    const Extent mirrored = extent_at_rest({in_sonar.x, in_sonar.y, -in_sonar.z}, edge_m);
    extent.aperture = std::max(extent.aperture, mirrored.aperture);
  }
  extent.aperture += turn + extent.bend;
  if ((horizontal - reach) * sin_half_ < 2 * radius) extent.bend = extent.aperture = radius;
  extent.level = level_of(extent);
  const double angle = reach / (horizontal - reach);
  extent.spread = spread_of(extent, horizontal - reach,
                            std::min(std::abs(in_sonar.x) / horizontal + angle, 1.0));
  extent.edge = edge_m;  // `cap` is known there
  return extent;
}

}  // namespace mapperd::map
