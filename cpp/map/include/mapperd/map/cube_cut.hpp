// The part of a unit cube on one side of a plane, in closed form.
#pragma once

#include "mapperd/common/vec.hpp"

namespace mapperd::map {

// Part of a cube of edge 1 around the origin where dot(normal, x) > -offset: 0 to 1, 1/2 at
// offset 0. The normal need not have length 1, but is not zero.
//
// It is the distribution of a sum of three uniform variables, a sum of cubes over the corners below
// the plane (Irwin and Hall); for normals along a face or an axis the limits of it, which the cubes
// would reach only with a loss of digits.
double part_beyond(const Vec3& normal, double offset);

}  // namespace mapperd::map
