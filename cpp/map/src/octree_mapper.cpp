#include "mapperd/map/octree_mapper.hpp"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <stdexcept>

#include "mapperd/map/octomap_file.hpp"
#include "mapperd/map/point_updates.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/snapshot.hpp"

namespace mapperd::map {
namespace {

IwloParams wide_clamps() {
  IwloParams params;
  params.L_min = -10.0;
  params.L_max = 10.0;
  return params;
}

double log_odds_of(double probability, const char* name) {
  if (!(probability > 0.0 && probability < 1.0)) {
    throw std::invalid_argument(std::string(name) + " must lie between 0 and 1");
  }
  return std::log(probability / (1.0 - probability));
}

void check_lengths(std::size_t points, std::size_t values, const char* name) {
  if (points != values) {
    throw std::invalid_argument(std::string(name) + " has " + std::to_string(values) +
                                " entries for " + std::to_string(points) + " points");
  }
}

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

}  // namespace

OctreeMapper::OctreeMapper(double resolution, double prob_hit, double prob_miss,
                           double prob_thres_min, double prob_thres_max)
    : map_(resolution, wide_clamps()) {
  set_probability_params(prob_hit, prob_miss);
  set_occupancy_thresholds(prob_thres_min, prob_thres_max);
}

void OctreeMapper::set_probability_params(double prob_hit, double prob_miss) {
  const double hit = log_odds_of(prob_hit, "prob_hit"), miss = log_odds_of(prob_miss, "prob_miss");
  if (!(miss <= 0 && hit >= 0)) {
    throw std::invalid_argument("prob_hit must be at least, prob_miss at most 0.5");
  }
  hit_ = hit;
  miss_ = miss;
}

void OctreeMapper::set_occupancy_thresholds(double min_thresh, double max_thresh) {
  const double low = log_odds_of(min_thresh, "min_thresh");
  const double high = log_odds_of(max_thresh, "max_thresh");
  if (!(low < 0 && high > 0)) {
    throw std::invalid_argument("min_thresh must be below, max_thresh above 0.5");
  }
  low_ = low;
  high_ = high;
}

void OctreeMapper::add_steps(const std::vector<double>& xyz, const std::vector<bool>& occupied) {
  check_lengths(xyz.size() / 3, occupied.size(), "occupied_flags");
  std::vector<double> steps;
  steps.reserve(occupied.size());
  for (const bool hit : occupied) steps.push_back(hit ? hit_ : miss_);
  add_log_odds(map_, {xyz.data(), occupied.size()}, steps.data(), {low_, high_});
}

void OctreeMapper::set_values(const std::vector<double>& xyz, const std::vector<double>& log_odds) {
  check_lengths(xyz.size() / 3, log_odds.size(), "log_odds_updates");
  set_log_odds(map_, {xyz.data(), log_odds.size()}, log_odds.data());
}

void OctreeMapper::add_segment(const Vec3& origin_m, const Vec3& end_m) {
  add_ray(map_, origin_m, end_m, hit_, miss_, {low_, high_});
}

std::vector<OctreeMapper::OccupiedVoxel> OctreeMapper::get_occupied_voxels(
    double min_probability) const {
  if (!(min_probability <= 1.0)) {
    throw std::invalid_argument("min_probability must be a number, at most 1");
  }
  const double least = min_probability < 0 ? 0.5 : min_probability;
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  std::vector<OccupiedVoxel> voxels;
  for (const KnownVoxel& known : voxels_between(map_, std::log(least / (1.0 - least)), kInfinity)) {
    const Vec3 centre = map_.centre_of(known.voxel);
    const double log_odds = static_cast<double>(known.state.log_odds);
    voxels.push_back({centre.x, centre.y, centre.z, 1.0 / (1.0 + std::exp(-log_odds))});
  }
  return voxels;
}

MemoryStats OctreeMapper::get_memory_usage() const {
  const MapSize size = size_of(map_);
  MemoryStats stats;
  stats.num_leaf_nodes = size.known_voxels;
  stats.num_nodes = size.known_voxels + size.blocks;
  stats.memory_mb = static_cast<double>(size.memory_bytes) * 1e-6;
  if (stats.num_nodes > 0) {
    stats.memory_efficiency =
        static_cast<double>(stats.num_leaf_nodes) / static_cast<double>(stats.num_nodes);
  }
  return stats;
}

void OctreeMapper::clear() { map::clear(map_); }

bool OctreeMapper::save_to_file(const std::string& filename) const {
  std::string data;
  try {
    data = ends_with(filename, ".ot") ? octomap_ot(map_) : octomap_bt(map_, 0.0, 0.0);
  } catch (const std::out_of_range&) {
    return false;
  }
  const std::string partial = filename + ".partial";
  std::ofstream file(partial, std::ios::binary);
  file.write(data.data(), static_cast<std::streamsize>(data.size()));
  file.close();
  if (file && std::rename(partial.c_str(), filename.c_str()) == 0) return true;
  std::remove(partial.c_str());
  return false;
}

bool OctreeMapper::load_from_file(const std::string& filename) {
  std::ifstream file(filename, std::ios::binary);
  const std::string data{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (file.bad() || !file.is_open()) return false;
  try {
    load_octomap(data, map_);
  } catch (const std::invalid_argument&) {
    return false;
  }
  return true;
}

}  // namespace mapperd::map
