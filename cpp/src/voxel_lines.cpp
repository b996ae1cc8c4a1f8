#include "mapperd/voxel_lines.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace mapperd {
namespace {

constexpr int kMostLines = 128;

// Lattices of 8, 16, ... 128 lines in the unit square about 0, by their number's logarithm.
struct Lattice {
  std::array<float, kMostLines> u;
  std::array<float, kMostLines> v;
};

Lattice lattice_of(int lines, int generator) {
  Lattice lattice{};
  for (int i = 0; i < lines; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const auto place = [lines](int step) {
      return (static_cast<float>(step % lines) + 0.5F) / static_cast<float>(lines) - 0.5F;
    };
    lattice.u[at] = place(i);
    lattice.v[at] = place(i * generator);
  }
  return lattice;
}

const Lattice& lattice_for(int lines) {
  static const std::array<Lattice, 5> lattices{lattice_of(8, 3), lattice_of(16, 7),
                                               lattice_of(32, 7), lattice_of(64, 19),
                                               lattice_of(128, 47)};
  return lattices[floor_log2(static_cast<std::size_t>(lines)) - 3];
}

// A plane nearly parallel to the lines cuts none of them; no division by zero then.
float not_zero(float slope) {
  constexpr float kParallel = 1e-9F;
  return std::abs(slope) < kParallel ? std::copysign(kParallel, slope) : slope;
}

std::size_t widest_axis(const std::array<double, 3>& v) {
  const double x = std::abs(v[0]);
  const double y = std::abs(v[1]);
  const double z = std::abs(v[2]);
  if (x >= y && x >= z) return 0;
  return y >= z ? 1 : 2;
}

}  // namespace

VoxelLines::VoxelLines(const Fan& fan, double edge_m, const Kernels& kernels)
    : fan_(fan), kernels_(kernels), edge_m_(edge_m) {
  for (std::size_t e = 0; e <= fan.beams(); ++e) {
    const Vec3& normal = fan.edge_normal(e);
    normals_[0].push_back(static_cast<float>(normal.x));
    normals_[1].push_back(static_cast<float>(normal.y));
    normals_[2].push_back(static_cast<float>(normal.z));
  }
}

bool VoxelLines::evidence(const Cube& cube, const FanPart& where, int lines,
                          Sample& sample) const {
  const std::array<double, 3>& c = cube.centre_m;
  const double range = std::sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
  const std::size_t beams = where.last_beam - where.first_beam + 1;
  if (range < kNearestForLines * edge_m_ || beams > kMaxBeamsOfVoxel) return false;
  const std::size_t t = widest_axis(c);
  const std::size_t u = (t + 1) % 3;
  const std::size_t v = (t + 2) % 3;
  const float forwards = c[t] < 0 ? -1.0F : 1.0F;

  const double rows_per_m = 1.0 / fan_.range_resolution_m();
  const auto first_row = static_cast<std::size_t>(std::max(where.near_m * rows_per_m, 0.0));
  const auto end_row = std::min(static_cast<std::size_t>(where.far_m * rows_per_m) + 1, fan_.rows());
  const auto row_of = [&](double r) {
    return static_cast<float>(r * rows_per_m - static_cast<double>(first_row));
  };
  LineTask task;
  task.half = static_cast<float>(cube.half_m);
  task.row = row_of(range);
  task.rows_per_m = static_cast<float>(rows_per_m);
  task.ahead_u = static_cast<float>(c[u] / range);
  task.ahead_v = static_cast<float>(c[v] / range);
  task.ahead_t = static_cast<float>(std::abs(c[t]) / range);
  task.inverse_range = static_cast<float>(1.0 / range);
  task.min_row = where.near_m < fan_.min_range_m() ? row_of(fan_.min_range_m()) : -1e9F;
  task.rows = first_row < end_row ? static_cast<int>(end_row - first_row) : 0;
  task.beams = static_cast<int>(beams);
  task.outermost_low = where.first_beam == 0;
  task.outermost_high = where.last_beam + 1 == fan_.beams();

  const auto plane_of = [&](float base, float nu, float nv, float nt) {
    return LinePlane{base, nu, nv, not_zero(nt * forwards)};
  };
  for (std::size_t i = 0; i <= beams; ++i) {
    const std::size_t e = where.first_beam + i;
    const double base = normals_[0][e] * c[0] + normals_[1][e] * c[1] + normals_[2][e] * c[2];
    task.edge[i] = plane_of(static_cast<float>(base), normals_[u][e], normals_[v][e], normals_[t][e]);
  }
  sample.any_return = false;
  for (std::size_t i = 0; i < beams; ++i) {
    const std::size_t j = where.first_beam + i;
    const bool any = fan_.any_return_in_rows(j, j, first_row, end_row);
    sample.any_return = sample.any_return || any;
    task.beam[i] = {any ? fan_.weights(j) + first_row : nullptr,
                    fan_.free_limit_m(j) > where.near_m ? row_of(fan_.free_limit_m(j)) : 0.0F};
  }
  task.cones = 0;
  if (where.cut_by_aperture) {
    const Vec3 in_sonar = fan_.to_sonar({c[0], c[1], c[2]});
    std::array<Vec3, 2> cone;
    fan_.aperture_planes_at(in_sonar, cone[0], cone[1]);
    for (const Vec3& n : cone) {
      const std::array<double, 3> normal{n.x, n.y, n.z};
      const double base = normal[0] * c[0] + normal[1] * c[1] + normal[2] * c[2];
      task.cone[task.cones++] =
          plane_of(static_cast<float>(base), static_cast<float>(normal[u]),
                   static_cast<float>(normal[v]), static_cast<float>(normal[t]));
    }
  }
  const Lattice& lattice = lattice_for(lines);
  const LineSums sums = kernels_.lines(task, lattice.u.data(), lattice.v.data(), lines / kLanes);
  sample.sum = {sums.occupied / edge_m_, sums.weighted / edge_m_, sums.free / edge_m_};
  sample.squared = sums.squared / edge_m_;
  return true;
}

}  // namespace mapperd
