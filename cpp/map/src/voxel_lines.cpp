#include "mapperd/map/voxel_lines.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace mapperd::map {
namespace {

constexpr int kMostLines = 128;
constexpr double kNearestForPlanes = 3.0;  // edges from the sonar's vertical axis

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

double component(const Vec3& v, std::size_t axis) {
  return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}

}  // namespace

VoxelLines::VoxelLines(const Fan& fan, double edge_m, const Kernels& kernels)
    : fan_(fan),
      kernels_(kernels),
      edge_m_(edge_m),
      per_edge_m_(static_cast<float>(1.0 / edge_m)),
      rows_per_m_(1.0 / fan.range_resolution_m()) {
  for (std::size_t j = 0; j < fan.beams(); ++j) {
    free_limit_rows_.push_back(fan.free_limit_m(j) * rows_per_m_);
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (const bool backwards : {false, true}) {
      const Direction direction{axis, backwards};
      for (std::size_t e = 0; e <= fan.beams(); ++e) {
        edge_planes_[table_of(direction)].push_back(plane_of(fan.edge_normal(e), direction));
      }
    }
  }
}

std::size_t VoxelLines::table_of(const Direction& direction) {
  return 2 * direction.axis + (direction.backwards ? 1 : 0);
}

VoxelLines::Direction VoxelLines::direction_at(const Vec3& centre) {
  const double x = std::abs(centre.x);
  const double y = std::abs(centre.y);
  const double z = std::abs(centre.z);
  const std::size_t axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
  return {axis, component(centre, axis) < 0};
}

LinePlane VoxelLines::plane_of(const Vec3& normal, const Direction& d) {
  const auto along = static_cast<float>(component(normal, d.axis));
  const float t = not_zero(d.backwards ? -along : along);
  return {static_cast<float>(component(normal, (d.axis + 1) % 3)),
          static_cast<float>(component(normal, (d.axis + 2) % 3)), t, -1.0F / t};
}

// The cones as the planes that touch them above and below the voxel; false where they bend too much
// for that, or few lines would miss what lies between them.
bool VoxelLines::cut_by_aperture(const Cube& cube, const Direction& direction,
                                 LineTask& task) const {
  const Vec3 centre = cube.centre();
  const Vec3 in_sonar = fan_.to_sonar(centre);
  const double horizontal = std::hypot(in_sonar.x, in_sonar.y);
  if (horizontal < kNearestForPlanes * edge_m_ ||
      2 * horizontal * fan_.sin_half_aperture() < edge_m_) {
    return false;
  }
  std::array<Vec3, 2> normals;
  fan_.aperture_planes_at(in_sonar, normals[0], normals[1]);
  for (const Vec3& normal : normals) {
    task.cone[task.cones] = plane_of(cube.of_place(normal), direction);
    task.cone_base[task.cones++] = static_cast<float>(dot(normal, centre));
  }
  return true;
}

// Of the beams that the voxel may lie in those that it does; returns the first.
std::size_t VoxelLines::find_beams(const Vec3& centre, double reach, const FanPart& where,
                                   LineTask& task) const {
  std::size_t first = where.first_beam;
  std::size_t last = where.last_beam;
  if (first < last) {
    while (first < last && dot(fan_.edge_normal(first + 1), centre) > reach) ++first;
    while (first < last && dot(fan_.edge_normal(last), centre) < -reach) --last;
  }
  for (std::size_t e = first; e <= last + 1; ++e) {
    task.edge_base[e - first] = static_cast<float>(dot(fan_.edge_normal(e), centre));
  }
  task.beams = static_cast<int>(last - first + 1);
  return first;
}

void VoxelLines::set_edges(const Cube& cube, const Direction& direction, std::size_t first_beam,
                           LineTask& task) const {
  if (cube.seen == nullptr) {
    task.edge = &edge_planes_[table_of(direction)][first_beam];
    return;
  }
  for (std::size_t i = 0; i <= static_cast<std::size_t>(task.beams); ++i) {
    task.seen_edge[i] = plane_of(cube.of_place(fan_.edge_normal(first_beam + i)), direction);
  }
  task.edge = task.seen_edge;
}

bool VoxelLines::prepare(const Cube& cube, const FanPart& where, LineTask& task) const {
  const Vec3 centre = cube.centre();
  const double range = norm(centre);
  const auto first_row = static_cast<std::size_t>(std::max(where.near_m * rows_per_m_, 0.0));
  const auto end_row =
      std::min(static_cast<std::size_t>(where.far_m * rows_per_m_) + 1, fan_.rows());
  if (range < kNearestForLines * edge_m_ ||
      where.last_beam - where.first_beam >= kMaxBeamsOfVoxel ||
      first_row + kMaxRowsOfVoxel < end_row) {
    return false;
  }
  // The lines run through the voxel as it is in the map: what is linear in what the sonar sees of
  // it is linear there.
  const Vec3 outward = cube.of_place(centre);
  const Direction direction = direction_at(outward);
  const double inverse_range = 1.0 / range;
  const auto rows_before = static_cast<double>(first_row);
  task.half = static_cast<float>(cube.half_m);
  task.row = static_cast<float>(range * rows_per_m_ - rows_before);
  task.rows_per_m = static_cast<float>(rows_per_m_);
  task.ahead_u = static_cast<float>(component(outward, (direction.axis + 1) % 3) * inverse_range);
  task.ahead_v = static_cast<float>(component(outward, (direction.axis + 2) % 3) * inverse_range);
  task.ahead_t = static_cast<float>(std::abs(component(outward, direction.axis)) * inverse_range);
  task.inverse_range = static_cast<float>(inverse_range);
  task.min_row = static_cast<float>(fan_.min_range_m() * rows_per_m_ - rows_before);
  const double stretch = cube.seen != nullptr ? 1 + fan_.view()->widening(centre, 0).stretch : 1.0;
  const double reach = cube.half_m * 1.7320508075688772 * stretch;  // to the corners
  const std::size_t first = find_beams(centre, reach, where, task);
  const auto beams = static_cast<std::size_t>(task.beams);
  task.outermost_low = first == 0;
  task.outermost_high = first + beams == fan_.beams();
  set_edges(cube, direction, first, task);
  task.any_return = false;
  for (std::size_t i = 0; i < beams; ++i) {
    const std::size_t j = first + i;
    const std::uint64_t returns = fan_.returns_in_rows(j, first_row, end_row);
    task.any_return = task.any_return || returns != 0;
    task.beam[i] = {fan_.weights(j) + first_row, returns,
                    static_cast<float>(free_limit_rows_[j] - rows_before)};
  }
  task.cones = 0;
  return !where.cut_by_aperture || cut_by_aperture(cube, direction, task);
}

VoxelLines::Sample VoxelLines::sample(const LineTask& task, int lines) const {
  const Lattice& lattice = lattice_for(lines);
  const LineSums sums = kernels_.lines(task, lattice.u.data(), lattice.v.data(), lines / kLanes);
  return {{sums.occupied * per_edge_m_, sums.weighted * per_edge_m_, sums.free * per_edge_m_},
          sums.squared * per_edge_m_};
}

}  // namespace mapperd::map
