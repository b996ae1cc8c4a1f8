// Bonxai's ProbabilisticMap::insertPointCloud, which is written to do as OctoMap's does.
#include <bonxai_map/probabilistic_map.hpp>
#include <limits>
#include <string>
#include <vector>

#include "run.hpp"

namespace {

using Bonxai::Point3D;
using Bonxai::ProbabilisticMap;

constexpr double kNoMaxRange = std::numeric_limits<double>::infinity();

// Bonxai's log-odds are whole numbers, six decimals.
int32_t fixed(float log_odds) { return static_cast<int32_t>(1e6 * double{log_odds}); }

void insert(ProbabilisticMap& map, const RayPing& ping) {
  std::vector<Point3D> points;
  points.reserve(ping.ends_m.size());
  for (const auto& end : ping.ends_m) {
    points.emplace_back(double{end[0]}, double{end[1]}, double{end[2]});
  }
  const Point3D origin(ping.origin_m[0], ping.origin_m[1], ping.origin_m[2]);
  map.insertPointCloud(points, origin, kNoMaxRange);
}

std::size_t count_touched(const RayPing& ping, double resolution_m) {
  ProbabilisticMap empty(resolution_m);
  insert(empty, ping);
  return empty.grid().activeCellsCount();
}

void measure(const std::string& rays, double resolution_m, double budget_ms,
             const std::string& /*way*/) {
  ProbabilisticMap map(resolution_m);
  ProbabilisticMap::Options options;
  options.prob_hit_log = fixed(kHit);
  options.prob_miss_log = fixed(kMiss);
  options.clamp_min_log = fixed(kMin);
  options.clamp_max_log = fixed(kMax);
  map.setOptions(options);
  Contender contender;
  contender.insert = [&](const RayPing& ping) { insert(map, ping); };
  contender.count_touched = [&](const RayPing& ping) { return count_touched(ping, resolution_m); };
  contender.memory_bytes = [&] { return map.grid().memUsage(); };
  contender.known_voxels = [&] { return map.grid().activeCellsCount(); };
  run(contender, read_rays(rays), budget_ms);
}

}  // namespace

int main(int argc, char** argv) { return contender_main(argc, argv, {}, measure); }
