// OctoMap's insertPointCloud, lazy and discretised, as its users call it for speed.
#include <octomap/octomap.h>

#include <cmath>
#include <string>

#include "run.hpp"

namespace {

constexpr double kNoMaxRange = -1.0;

double probability_of(float log_odds) { return 1.0 / (1.0 + std::exp(-double{log_odds})); }

octomap::Pointcloud cloud_of(const RayPing& ping) {
  octomap::Pointcloud cloud;
  cloud.reserve(ping.ends_m.size());
  for (const auto& end : ping.ends_m) cloud.push_back(end[0], end[1], end[2]);
  return cloud;
}

octomap::point3d origin_of(const RayPing& ping) {
  return {static_cast<float>(ping.origin_m[0]), static_cast<float>(ping.origin_m[1]),
          static_cast<float>(ping.origin_m[2])};
}

std::size_t count_touched(octomap::OcTree& tree, const RayPing& ping) {
  octomap::KeySet free_cells;
  octomap::KeySet occupied_cells;
  tree.computeDiscreteUpdate(cloud_of(ping), origin_of(ping), free_cells, occupied_cells,
                             kNoMaxRange);
  return free_cells.size() + occupied_cells.size();
}

void measure(const std::string& rays, double resolution_m, double budget_ms,
             const std::string& /*way*/) {
  octomap::OcTree tree(resolution_m);
  tree.setProbHit(probability_of(kHit));
  tree.setProbMiss(probability_of(kMiss));
  tree.setClampingThresMin(probability_of(kMin));
  tree.setClampingThresMax(probability_of(kMax));
  Contender contender;
  contender.insert = [&](const RayPing& ping) {
    tree.insertPointCloud(cloud_of(ping), origin_of(ping), kNoMaxRange, true, true);
  };
  contender.count_touched = [&](const RayPing& ping) { return count_touched(tree, ping); };
  contender.memory_bytes = [&] { return tree.memoryUsage(); };
  contender.known_voxels = [&] { return tree.getNumLeafNodes(); };
  run(contender, read_rays(rays), budget_ms);
}

}  // namespace

int main(int argc, char** argv) { return contender_main(argc, argv, {}, measure); }
