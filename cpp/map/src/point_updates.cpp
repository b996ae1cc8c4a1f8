#include "mapperd/map/point_updates.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

#include "mapperd/map/block_writer.hpp"
#include "mapperd/map/voxel_walk.hpp"

namespace mapperd::map {
namespace {

std::vector<VoxelIndex> voxels_of(const VoxelMap& map, const Points& points) {
  check_finite(points, "points_m");
  std::vector<VoxelIndex> voxels(points.count);
  for (std::size_t i = 0; i < points.count; ++i) {
    if (!map.index_of(points[i], voxels[i])) {
      throw std::invalid_argument("points_m: beyond the map's reach in row " + std::to_string(i));
    }
  }
  return voxels;
}

void check_numbers(const double* values, std::size_t count, const char* name, double lowest) {
  for (std::size_t i = 0; i < count; ++i) {
    if (!(std::isfinite(values[i]) && values[i] >= lowest)) {
      throw std::invalid_argument(std::string(name) + ": not a finite number in its range in row " +
                                  std::to_string(i));
    }
  }
}

// Rows ordered by the blocks of their voxels; those of one block stay in their order.
std::vector<std::size_t> by_block(const std::vector<VoxelIndex>& voxels) {
  std::vector<std::size_t> rows(voxels.size());
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  std::stable_sort(rows.begin(), rows.end(), [&voxels](std::size_t a, std::size_t b) {
    return block_holding(voxels[a]) < block_holding(voxels[b]);
  });
  return rows;
}

// In whole units. Steps and limits of any size come to no more than the whole span of log-odds.
std::int64_t whole_units(const IwloRule& rule, double log_odds) {
  return std::llrint(std::clamp(log_odds, -2 * kMaxLogOdds, 2 * kMaxLogOdds) / rule.unit());
}

// One observation that leaves a voxel at the given log-odds.
void put(BlockWriter& writer, const IwloRule& rule, const VoxelIndex& voxel, std::int64_t units) {
  const int count = std::min<int>(writer.at(voxel).count + 1, rule.settled_count());
  writer.set(voxel, {rule.clamped(units), static_cast<std::uint16_t>(count)});
}

void add_step(BlockWriter& writer, const IwloRule& rule, const VoxelIndex& voxel, double step,
              const StepLimits& limits) {
  const std::int64_t before = writer.at(voxel).units;
  const std::int64_t sum = before + whole_units(rule, step);
  const double prior = rule.params().prior;
  const std::int64_t high = whole_units(rule, limits.high - prior);
  const std::int64_t low = whole_units(rule, limits.low - prior);
  const std::int64_t updated =
      step > 0 ? std::min(sum, std::max(high, before)) : std::max(sum, std::min(low, before));
  put(writer, rule, voxel, updated);
}

}  // namespace

void observe(VoxelMap& map, const ObservedPoints& observed) {
  const std::size_t n = observed.points.count;
  check_numbers(observed.intensity, n, "intensities", 0.0);
  if (observed.step_factor != nullptr) check_numbers(observed.step_factor, n, "weights", 0.0);
  const std::vector<VoxelIndex> voxels = voxels_of(map, observed.points);
  const IwloRule& rule = map.rule();
  const WriteLock lock(map);
  BlockWriter writer(map);
  for (const std::size_t i : by_block(voxels)) {
    const Voxel before = writer.at(voxels[i]);
    const double log_odds = rule.log_odds(before.units);
    const double step = observed.occupied[i]
                            ? rule.occupied_step(log_odds, before.count,
                                                 rule.occupied_weight(observed.intensity[i]))
                            : rule.free_step(log_odds, before.count);
    const double factor = observed.step_factor == nullptr ? 1.0 : observed.step_factor[i];
    put(writer, rule, voxels[i], before.units + whole_units(rule, factor * step));
  }
}

void add_log_odds(VoxelMap& map, const Points& points, const double* steps,
                  const StepLimits& limits) {
  check_numbers(steps, points.count, "steps", -HUGE_VAL);
  const std::vector<VoxelIndex> voxels = voxels_of(map, points);
  const WriteLock lock(map);
  BlockWriter writer(map);
  for (const std::size_t i : by_block(voxels)) {
    add_step(writer, map.rule(), voxels[i], steps[i], limits);
  }
}

void set_log_odds(VoxelMap& map, const Points& points, const double* values) {
  check_numbers(values, points.count, "log_odds", -HUGE_VAL);
  const std::vector<VoxelIndex> voxels = voxels_of(map, points);
  const WriteLock lock(map);
  BlockWriter writer(map);
  for (const std::size_t i : by_block(voxels)) {
    put(writer, map.rule(), voxels[i], map.rule().units(values[i]));
  }
}

void add_ray(VoxelMap& map, const Vec3& origin_m, const Vec3& end_m, double hit, double miss,
             const StepLimits& limits) {
  const double ends[] = {origin_m.x, origin_m.y, origin_m.z, end_m.x, end_m.y, end_m.z};
  const std::vector<VoxelIndex> voxels = voxels_of(map, {ends, 2});
  const double length_m = norm(end_m - origin_m);
  if (!(length_m <= kMaxRayVoxels * map.resolution_m())) {
    throw std::invalid_argument("a ray must not be longer than a million voxels");
  }
  const WriteLock lock(map);
  BlockWriter writer(map);
  if (!(voxels[0] == voxels[1])) {
    VoxelWalk walk(map.resolution_m(), voxels[0], origin_m, unit_vector(end_m - origin_m));
    for (; !(walk.voxel() == voxels[1]) && walk.entry_m() < length_m; walk.advance()) {
      add_step(writer, map.rule(), walk.voxel(), miss, limits);
    }
  }
  add_step(writer, map.rule(), voxels[1], hit, limits);
}

}  // namespace mapperd::map
