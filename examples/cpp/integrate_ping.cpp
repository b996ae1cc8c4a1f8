// A sonar looks at a wall 4 m ahead: integrate its pings and ask the map what it found.
#include <cmath>
#include <cstdio>
#include <vector>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/voxel_map.hpp"

int main() {
  using namespace mapperd::map;

  constexpr std::size_t kRows = 500, kBeams = 256;
  constexpr double kRangeResolution_m = 0.02;
  std::vector<double> bearings_rad(kBeams);
  for (std::size_t beam = 0; beam < kBeams; ++beam) {
    bearings_rad[beam] = std::asin((2.0 * (beam + 0.5) / kBeams - 1.0) * std::sin(0.6));
  }
  std::vector<float> intensity(kRows * kBeams, 0.0F);
  for (std::size_t beam = 0; beam < kBeams; ++beam) {
    const double range_m = 4.0 / std::cos(bearings_rad[beam]);
    const auto row = static_cast<std::size_t>(range_m / kRangeResolution_m);
    for (std::size_t r = row; r < row + 3; ++r) intensity[r * kBeams + beam] = 180.0F;
  }
  const PingImage image{intensity.data(), kRows, kBeams, bearings_rad.data(), kRangeResolution_m};

  VoxelMap map(0.1, IwloParams{});  // voxels of 10 cm
  for (int ping = 0; ping < 5; ++ping) {
    mapperd::Transform map_T_sonar;
    map_T_sonar.translation.y = 0.1 * ping;
    integrate_evidence_grid(map, image, map_T_sonar, {});
  }

  const double points_m[] = {4.0, 0.2, 0.0, 2.0, 0.2, 0.0, 5.0, 0.2, 0.0};
  const char* const names[] = {"unknown", "free", "occupied"};
  const auto classes = classify(map, {points_m, 3}, {});
  for (std::size_t i = 0; i < 3; ++i) {
    std::printf("%.0f m ahead: %s\n", points_m[3 * i], names[static_cast<int>(classes[i]) + 1]);
  }
  const std::vector<double> depth_m = ray_cast_depth(map, {points_m + 3, 1}, {points_m, 1}, 10, 0);
  std::printf("%zu voxels known; the wall is %.2f m ahead of the second point\n", known_count(map),
              depth_m[0]);
  return 0;
}
