#include "mapperd/map/ping_box.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace mapperd::map {
namespace {

constexpr int kBearings = 16;
constexpr int kElevations = 4;

// Range up to which the ping has evidence, m: the end of its last return, or max_range if it
// carves.
double evidence_range_m(const PingImage& image, const PingParams& settings, const IwloRule& rule) {
  if (settings.carve_no_return) return image.max_range_m();
  for (std::size_t row = image.rows; row > 0; --row) {
    const float* const first = image.intensity + (row - 1) * image.beams;
    const bool any = std::any_of(first, first + image.beams,
                                 [&rule](float intensity) { return rule.is_return(intensity); });
    if (any) return static_cast<double>(row) * image.range_resolution_m;
  }
  return 0.0;
}

// How far from the fan at transmission what a moving sonar sees there may lie: it is turned, and
// shifted on both ways by less than twice what the sonar moves meanwhile.
double moved_m(const PingMotion& motion, double range_m) {
  if (!motion.any()) return 0.0;
  const double speed = norm(motion.linear_mps) / motion.speed_of_sound_mps;
  const double turn = 2.2 * range_m / motion.speed_of_sound_mps * norm(motion.angular_radps);
  return range_m * (std::min(turn, 2.0) + 5 * speed);
}

}  // namespace

std::optional<BlockBox> blocks_of_ping(const VoxelMap& map, const PingImage& image,
                                       const Transform& map_T_sonar, const PingParams& settings,
                                       const PingMotion& motion) {
  check_ping(image, settings);
  check_reach(map, map_T_sonar, image.max_range_m(), motion);
  const double range_m = evidence_range_m(image, settings, map.rule());
  if (!(range_m > 0)) return std::nullopt;
  const double block_m = map.resolution_m() * kBlockEdge;
  const BlockPose start = at_transmission(map_T_sonar, motion, block_m);
  std::vector<double> edges = beam_edge_sines(image.bearings_rad, image.beams);
  for (double& edge : edges) edge = std::asin(edge);
  const double bearing_step = (edges.back() - edges.front()) / kBearings;
  const double elevation_step = settings.vertical_aperture_rad / kElevations;
  // Between samples half a step apart a sphere bulges by the square of that over two, each way.
  const double bulge = (bearing_step * bearing_step + elevation_step * elevation_step) / 8;
  const double slack_m = range_m * bulge + moved_m(motion, range_m) + 0.5 * block_m;
  Vec3 low;
  Vec3 high;
  for (int i = 0; i <= kBearings; ++i) {
    for (int k = 0; k <= kElevations; ++k) {
      const double elevation = -settings.vertical_aperture_rad / 2 + k * elevation_step;
      const Vec3 at = start.block_T_sonar.rotate(
          fan_point(range_m, edges.front() + i * bearing_step, elevation));
      low = {std::min(low.x, at.x), std::min(low.y, at.y), std::min(low.z, at.z)};
      high = {std::max(high.x, at.x), std::max(high.y, at.y), std::max(high.z, at.z)};
    }
  }
  const auto block = [&](double place_m, double offset_m, std::int32_t origin) {
    return origin + static_cast<std::int32_t>(std::floor((place_m + offset_m) / block_m));
  };
  const Vec3& at = start.block_T_sonar.translation;
  return BlockBox{
      {block(low.x, at.x - slack_m, start.block.x), block(low.y, at.y - slack_m, start.block.y),
       block(low.z, at.z - slack_m, start.block.z)},
      {block(high.x, at.x + slack_m, start.block.x), block(high.y, at.y + slack_m, start.block.y),
       block(high.z, at.z + slack_m, start.block.z)}};
}

}  // namespace mapperd::map
