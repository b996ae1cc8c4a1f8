#include "mapperd/map/ping.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace mapperd::map {
namespace {

constexpr double kHalfPi = 1.5707963267948966;
constexpr double kMaxCells = 64.0 * 1024 * 1024;  // far above 16 MiB of any real message
constexpr double kMaxRange = 10000.0;
constexpr double kFinestRow = 1e-6;
constexpr std::size_t kMaxBeams = 65536;
constexpr int kMaxThreads = 64;
constexpr double kMinDetail = 0.25;
constexpr double kMaxDetail = 8.0;

void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(what);
}

}  // namespace

void check_ping(const PingImage& image, const PingParams& settings) {
  require(image.rows >= 1 && image.beams >= 2,
          "intensity must have at least one row and two beams");
  require(static_cast<double>(image.rows) * static_cast<double>(image.beams) <= kMaxCells,
          "intensity has more than 2^26 samples");
  require(image.beams <= kMaxBeams, "intensity has more than 65536 beams");
  require(std::isfinite(image.range_resolution_m) && image.range_resolution_m >= kFinestRow,
          "range_resolution_m must be finite, and a micrometre or more");
  require(image.max_range_m() <= kMaxRange, "the ping reaches farther than 10 km");
  for (std::size_t j = 0; j < image.beams; ++j) {
    require(std::abs(image.bearings_rad[j]) <= kHalfPi,
            "bearings_rad must be finite and lie within +-90 degrees");
    require(j == 0 || image.bearings_rad[j] > image.bearings_rad[j - 1],
            "bearings_rad must increase strictly");
  }
  require(settings.vertical_aperture_rad > 0 && settings.vertical_aperture_rad < 2 * kHalfPi,
          "vertical_aperture_rad must lie between 0 and 180 degrees");
  require(std::isfinite(settings.min_range_m) && settings.min_range_m >= 0,
          "min_range_m must be finite, 0 or more");
  require(settings.detail >= kMinDetail && settings.detail <= kMaxDetail,
          "detail must lie between 0.25 and 8");
  require(settings.threads >= 1 && settings.threads <= kMaxThreads,
          "threads must lie between 1 and 64");
}

std::vector<double> beam_edge_sines(const double* bearings_rad, std::size_t beams) {
  std::vector<double> sines(beams);
  std::transform(bearings_rad, bearings_rad + beams, sines.begin(),
                 [](double b) { return std::sin(b); });
  std::vector<double> edges(beams + 1);
  for (std::size_t j = 1; j < beams; ++j) edges[j] = 0.5 * (sines[j - 1] + sines[j]);
  edges[0] = sines[0] - 0.5 * (sines[1] - sines[0]);
  edges[beams] = sines[beams - 1] + 0.5 * (sines[beams - 1] - sines[beams - 2]);
  for (double& edge : edges) edge = std::clamp(edge, -1.0, 1.0);
  return edges;
}

Vec3 fan_point(double range_m, double bearing_rad, double elevation_rad) {
  const double horizontal = range_m * std::cos(elevation_rad);
  return {horizontal * std::cos(bearing_rad), -horizontal * std::sin(bearing_rad),
          range_m * std::sin(elevation_rad)};
}

BlockPose at_transmission(const Transform& map_T_sonar, const PingMotion& motion, double block_m) {
  BlockPose start{{}, map_T_sonar};
  const auto split = [block_m](double& position, std::int32_t& block) {
    const double whole = std::floor(position / block_m);
    block += static_cast<std::int32_t>(whole);
    position -= whole * block_m;
  };
  Vec3& at = start.block_T_sonar.translation;
  const auto split_all = [&] {
    split(at.x, start.block.x);
    split(at.y, start.block.y);
    split(at.z, start.block.z);
  };
  split_all();
  if (!motion.any()) return start;
  start.block_T_sonar = turned_to_transmission(start.block_T_sonar, motion);
  at = at - motion.valid_s * motion.linear_mps;
  split_all();
  return start;
}

void check_reach(const VoxelMap& map, const Transform& map_T_sonar, double max_range_m,
                 const PingMotion& motion) {
  check_motion(motion, max_range_m);
  const double block_m = map.resolution_m() * kBlockEdge;
  // A moving sonar was elsewhere, and what it sees is nearer by less than a fiftieth.
  const double reach_m =
      motion.any() ? 1.02 * max_range_m + std::abs(motion.valid_s) * norm(motion.linear_mps)
                   : max_range_m;
  const Vec3& at = map_T_sonar.translation;
  for (const double position : {at.x, at.y, at.z}) {
    if (!std::isfinite(position)) throw std::invalid_argument("map_T_sonar is not finite");
    if ((std::abs(position) + reach_m) / block_m + 2 > kMaxBlock) {
      throw std::out_of_range("the ping lies beyond the map's reach");
    }
  }
  const auto& [x, y, z] = map_T_sonar.rows;
  const auto zero = [](double v) { return std::abs(v) < 1e-6; };
  const double handedness =
      dot(x, {y.y * z.z - y.z * z.y, y.z * z.x - y.x * z.z, y.x * z.y - y.y * z.x});
  if (!(zero(norm(x) - 1) && zero(norm(y) - 1) && zero(norm(z) - 1) && zero(dot(x, y)) &&
        zero(dot(y, z)) && zero(dot(z, x)) && handedness > 0)) {
    throw std::invalid_argument("map_T_sonar is no rigid transform");
  }
}

}  // namespace mapperd::map
