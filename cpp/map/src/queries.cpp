#include "mapperd/map/queries.hpp"

#include <cmath>
#include <stdexcept>
#include <string>

#include "mapperd/map/voxel_walk.hpp"

namespace mapperd::map {
namespace {

bool is_finite(const Vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

std::string in_row(std::size_t row) { return " in row " + std::to_string(row); }

double depth_along(const VoxelMap& map, VoxelWalk walk, double max_range_m,
                   double occupied_log_odds) {
  for (; walk.entry_m() <= max_range_m; walk.advance()) {
    const VoxelState state = map.at(walk.voxel());
    if (state.count != 0 && state.log_odds > occupied_log_odds) return walk.entry_m();
  }
  return -1.0;
}

}  // namespace

void check_thresholds(const Thresholds& thresholds) {
  if (!(thresholds.free_log_odds <= thresholds.occupied_log_odds)) {
    throw std::invalid_argument("free_log_odds must be a number, at most occupied_log_odds");
  }
}

void check_finite(const Points& points, const char* name) {
  for (std::size_t i = 0; i < points.count; ++i) {
    if (!is_finite(points[i])) {
      throw std::invalid_argument(std::string(name) + ": not finite" + in_row(i));
    }
  }
}

std::vector<Occupancy> classify(const VoxelMap& map, const Points& points,
                                const Thresholds& thresholds) {
  check_thresholds(thresholds);
  check_finite(points, "points_m");
  std::vector<Occupancy> answers(points.count);
  const ReadLock lock(map);
  for (std::size_t i = 0; i < points.count; ++i) answers[i] = thresholds.of(map.at(points[i]));
  return answers;
}

std::vector<Occupancy> classify_box(const VoxelMap& map, const VoxelBox& box,
                                    const Thresholds& thresholds) {
  check_thresholds(thresholds);
  check_dense(box);
  std::vector<Occupancy> answers(box.count(), Occupancy::kUnknown);
  const ReadLock lock(map);
  for_each_known_in(map, box, [&](const VoxelIndex& voxel, const VoxelState& state) {
    answers[box.place_of(voxel)] = thresholds.of(state);
  });
  return answers;
}

std::vector<double> ray_cast_depth(const VoxelMap& map, const Points& origins,
                                   const Points& directions, double max_range_m,
                                   double occupied_log_odds) {
  if (origins.count != directions.count) {
    throw std::invalid_argument("origins_m and directions must have as many rows");
  }
  if (!(max_range_m >= 0 && max_range_m <= kMaxRayVoxels * map.resolution_m())) {
    throw std::invalid_argument("max_range_m must lie between 0 and a million voxels");
  }
  if (std::isnan(occupied_log_odds)) {
    throw std::invalid_argument("occupied_log_odds must be a number");
  }
  check_finite(origins, "origins_m");
  check_finite(directions, "directions");
  std::vector<double> depths(origins.count);
  const ReadLock lock(map);
  for (std::size_t i = 0; i < origins.count; ++i) {
    const Vec3 direction = directions[i];
    if (direction.x == 0 && direction.y == 0 && direction.z == 0) {
      throw std::invalid_argument("directions: length 0" + in_row(i));
    }
    VoxelIndex start;
    if (!map.index_of(origins[i], start)) {
      throw std::invalid_argument("origins_m: beyond the map's reach" + in_row(i));
    }
    const VoxelWalk walk(map.resolution_m(), start, origins[i], unit_vector(direction));
    depths[i] = depth_along(map, walk, max_range_m, occupied_log_odds);
  }
  return depths;
}

std::vector<KnownVoxel> occupied_in(const VoxelMap& map, const VoxelBox& box,
                                    double occupied_log_odds) {
  if (std::isnan(occupied_log_odds)) {
    throw std::invalid_argument("occupied_log_odds must be a number");
  }
  std::vector<KnownVoxel> found;
  const ReadLock lock(map);
  for_each_known_in(map, box, [&](const VoxelIndex& voxel, const VoxelState& state) {
    if (state.log_odds > occupied_log_odds) found.push_back({voxel, state});
  });
  return found;
}

std::size_t known_count(const VoxelMap& map) {
  const ReadLock lock(map);
  return map.known_count();
}

}  // namespace mapperd::map
