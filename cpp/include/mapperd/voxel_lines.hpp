// A ping's evidence over a voxel's volume, sampled along parallel lines through the voxel.
//
// The lines run along the axis that is nearest to the direction of range. Along a line everything
// is exact: where it crosses from beam to beam and from row to row. Across, the lines lie on a
// lattice of rank one (Korobov), whose projection on either axis is evenly spaced: a plane between
// beams that is parallel to the lines, the worst case, is off by half a step at most.
#pragma once

#include <array>
#include <vector>

#include "mapperd/fan.hpp"
#include "mapperd/kernels.hpp"
#include "mapperd/voxel_integral.hpp"

namespace mapperd {

// Nearer than this many voxels the sonar is too near for the series that the lines use.
inline constexpr double kNearestForLines = 8.0;

class VoxelLines {
 public:
  struct Sample {
    Evidence sum;
    double squared = 0.0;     // integral of the squared w(I)
    bool any_return = false;  // in the rows and beams that the voxel touches
  };

  VoxelLines(const Fan& fan, double edge_m, const Kernels& kernels);

  // False, and nothing done, for voxels too near to the sonar or with too many beams.
  // `lines` is 8, 16, 32, 64 or 128.
  bool evidence(const Cube& cube, const FanPart& where, int lines, Sample& sample) const;

 private:
  const Fan& fan_;
  const Kernels& kernels_;
  double edge_m_;
  std::array<std::vector<float>, 3> normals_;  // of the beams' edges, by axis
};

}  // namespace mapperd
