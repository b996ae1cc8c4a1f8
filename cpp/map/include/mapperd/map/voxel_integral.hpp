// The exact integral of a ping's evidence over a voxel's volume.
//
// Along a beam the evidence f depends on range alone. The field F = C(r) / r^2 r_hat, with
// C(r) = int_0^r f u^2 du, has divergence f, so the volume integral over the part of a cube inside
// a beam is F's flux through that part's surface. Bearing planes and the aperture run through the
// sonar and carry no flux: what counts are the cube's faces, clipped to the beam. On a face at
// distance d the flux density d C(r) / r^3 is symmetric about the foot of the perpendicular from
// the sonar; once more by the divergence theorem, with D(r) = int C / u^2 du, the integral over
// the clipped face is the sum over its edges of d int D(r) dtheta, theta being the angle about the
// foot. Along an edge at distance q from the foot, t from its own foot, r^2 = d^2 + q^2 + t^2:
//
//   d int D dtheta = d offset [theta] + d f / 6 (q [t] + d^2 [theta]) - flux [psi],
//   theta = atan(t / q),  psi = atan(d t / (q r)),
//
// with f, flux and offset those of the range piece (radial.hpp). No sampling, no approximation
// but one: inside a beam the aperture's cone is replaced by planes through the sonar, as many as
// keep it within a ten-thousandth of a voxel.
#pragma once

#include <array>
#include <cstddef>

#include "mapperd/map/fan.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::map {

// A cube parallel to the map's axes, with the sonar as the origin: as a sonar at rest sees it. What
// a moving one sees of it is nearly a parallelepiped, and all the above holds for its faces as
// well.
struct Cube {
  std::array<double, 3> centre_m;
  double half_m;
  const SeenAxes* seen = nullptr;  // what the map's axes look like; null: as they are

  Vec3 centre() const { return {centre_m[0], centre_m[1], centre_m[2]}; }
  // A linear function of what is seen, as one of the place.
  Vec3 of_place(const Vec3& normal) const {
    return seen != nullptr ? seen->of_place(normal) : normal;
  }
};

// What a ping says of a voxel, as parts of its volume.
struct Evidence {
  double occupied = 0.0;
  double weighted = 0.0;  // integral of w(I) over the occupied part
  double free = 0.0;

  double weight() const { return weighted / occupied; }
};

// Integrals over the cube, as parts of its volume.
Two occupied_part(const Fan& fan, const Cube& cube, const FanPart& where);
double free_part(const Fan& fan, const Cube& cube, const FanPart& where);

}  // namespace mapperd::map
