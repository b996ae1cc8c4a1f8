// A ping's evidence over a voxel's volume, sampled along parallel lines through the voxel.
//
// The lines run along the axis that is nearest to the direction of range. Along a line it is
// followed where it crosses from beam to beam and from row to row, with a series for its range and
// planes for the aperture's cones. Across, the lines lie on a
// lattice of rank one (Korobov), whose projection on either axis is evenly spaced: a plane between
// beams that is parallel to the lines is off by half a step at most if it runs along an axis;
// askew, by half of the lattice's widest gap, up to some 1 / sqrt(lines) of the voxel.
#pragma once

#include <array>
#include <vector>

#include "mapperd/map/fan.hpp"
#include "mapperd/map/kernels.hpp"
#include "mapperd/map/voxel_integral.hpp"

namespace mapperd::map {

// Nearer than this many voxels the sonar is too near for the series that the lines use.
inline constexpr double kNearestForLines = 4.0;

class VoxelLines {
 public:
  struct Sample {
    Evidence sum;
    double squared = 0.0;  // integral of the squared w(I)
  };

  VoxelLines(const Fan& fan, double edge_m, const Kernels& kernels);

  // What the kernel has to know of a voxel. False for voxels too near to the sonar, or with too
  // many beams or rows.
  bool prepare(const Cube& cube, const FanPart& where, LineTask& task) const;

  // Samples a prepared voxel along 8, 16, 32, 64 or 128 lines.
  Sample sample(const LineTask& task, int lines) const;

 private:
  // The lines' direction: an axis of the map, either way.
  struct Direction {
    std::size_t axis;
    bool backwards;
  };
  static Direction direction_at(const Vec3& centre);
  static std::size_t table_of(const Direction& direction);
  static LinePlane plane_of(const Vec3& normal, const Direction& direction);
  std::size_t find_beams(const Vec3& centre, double reach_m, const FanPart& where,
                         LineTask& task) const;
  void set_edges(const Cube& cube, const Direction& direction, std::size_t first_beam,
                 LineTask& task) const;
  bool cut_by_aperture(const Cube& cube, const Direction& direction, LineTask& task) const;

  const Fan& fan_;
  const Kernels& kernels_;
  double edge_m_;
  float per_edge_m_;
  double rows_per_m_;
  std::vector<double> free_limit_rows_;                // by beam
  std::array<std::vector<LinePlane>, 6> edge_planes_;  // by direction
};

}  // namespace mapperd::map
