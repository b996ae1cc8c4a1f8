#include "localization/range_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "localization/block_poses.hpp"
#include "localization/distance_transform.hpp"

namespace mapperd::localization {
namespace {

constexpr float kBlocked = -1.0F;
constexpr float kOutside = -2.0F;
constexpr double kAhead = 1e-9;  // cells; who is that near to an edge ahead counts as beyond it

// Two points in cells whose centres are d apart are at least d - sqrt(2) apart.
float step_of(std::int32_t squared) {
  if (squared == kBeyond) return 1e6F;
  return std::max(0.0F, static_cast<float>(std::sqrt(static_cast<double>(squared)) - 1.41422));
}

double not_zero(double along) {
  if (std::abs(along) > 1e-12) return along;
  return along > 0.0 ? 1e-12 : -1e-12;
}

struct March {
  double ahead_u[kBlock];
  double ahead_v[kBlock];
  double inverse_u[kBlock];
  double inverse_v[kBlock];
  double gone[kBlock];
  double found[kBlock];  // what the map says there
};

struct Steps {
  const float* cells;
  std::int32_t stride;
  double last_u, last_v;
  double most;
};

// One step of all rays; whether any went on.
LOCALIZATION_VECTORISED bool step_on(const RayBlock& rays, const Steps& steps, March& march) {
  const Steps s = steps;
  double went_on = 0.0;
  for (std::size_t i = 0; i < kBlock; ++i) {
    const double gone = march.gone[i];
    double u = rays.u[i] + gone * rays.along_u[i] + march.ahead_u[i];
    double v = rays.v[i] + gone * rays.along_v[i] + march.ahead_v[i];
    u = u > 0.0 ? u : 0.0;
    v = v > 0.0 ? v : 0.0;
    u = u < s.last_u ? u : s.last_u;
    v = v < s.last_v ? v : s.last_v;
    const auto column = static_cast<std::int32_t>(u);
    const auto row = static_cast<std::int32_t>(v);
    const double safe = static_cast<double>(s.cells[row * s.stride + column]);
    const double edge_u = static_cast<double>(column) + (rays.along_u[i] > 0.0 ? 1.0 : 0.0);
    const double edge_v = static_cast<double>(row) + (rays.along_v[i] > 0.0 ? 1.0 : 0.0);
    const double leave_u = (edge_u - rays.u[i]) * march.inverse_u[i];
    const double leave_v = (edge_v - rays.v[i]) * march.inverse_v[i];
    const double leave = leave_u < leave_v ? leave_u : leave_v;
    const double clear = gone + safe;
    double next = leave > clear ? leave : clear;
    next = next < s.most ? next : s.most;
    next = safe >= 0.0 ? next : gone;
    march.found[i] = safe;
    went_on = next > gone ? 1.0 : went_on;
    march.gone[i] = next;
  }
  return went_on > 0.0;
}

}  // namespace

RangeMap::RangeMap(const OccupancyGrid& grid, bool unknown_blocks, int threads)
    : frame_(grid.frame) {
  check_frame(frame_);
  if (grid.cells.size() != frame_.cells()) throw std::invalid_argument("cells are missing");
  std::vector<std::uint8_t> blocks(grid.cells.size());
  std::transform(grid.cells.begin(), grid.cells.end(), blocks.begin(), [&](std::int8_t cell) {
    return cell == kOccupied || (unknown_blocks && cell != kFree) ? std::uint8_t{1}
                                                                  : std::uint8_t{0};
  });
  const std::vector<std::int32_t> squared =
      squared_distances(blocks, frame_.rows, frame_.columns, 1 << 19, threads);
  steps_.assign((frame_.rows + 2) * (frame_.columns + 2), kOutside);
  for (std::size_t r = 0; r < frame_.rows; ++r) {
    const std::size_t from = r * frame_.columns;
    float* to = &steps_[(r + 1) * (frame_.columns + 2) + 1];
    for (std::size_t c = 0; c < frame_.columns; ++c) {
      to[c] = squared[from + c] == 0 ? kBlocked : step_of(squared[from + c]);
    }
  }
}

void RangeMap::cast(const RayBlock& rays, double most, double* out) const {
  March march;
  for (std::size_t i = 0; i < kBlock; ++i) {
    march.inverse_u[i] = 1.0 / not_zero(rays.along_u[i]);
    march.inverse_v[i] = 1.0 / not_zero(rays.along_v[i]);
    march.ahead_u[i] = rays.along_u[i] > 0.0 ? kAhead : -kAhead;
    march.ahead_v[i] = rays.along_v[i] > 0.0 ? kAhead : -kAhead;
    march.gone[i] = 0.0;
  }
  const Steps steps{steps_.data(), static_cast<std::int32_t>(frame_.columns + 2),
                    static_cast<double>(frame_.columns) + 1.0,
                    static_cast<double>(frame_.rows) + 1.0, most};
  while (step_on(rays, steps, march)) {
  }
  for (std::size_t i = 0; i < kBlock; ++i) {
    out[i] = march.found[i] == static_cast<double>(kOutside) ? kNoExpectation : march.gone[i];
  }
}

double RangeMap::cast(const Pose2& ray, double max_range_m) const {
  BlockPoses poses;
  pose_block(&ray.x, &ray.y, &ray.yaw, 1, lattice_of(frame_), poses);
  RayBlock rays;
  std::copy(poses.u, poses.u + kBlock, rays.u);
  std::copy(poses.v, poses.v + kBlock, rays.v);
  std::copy(poses.cosine, poses.cosine + kBlock, rays.along_u);
  std::copy(poses.sine, poses.sine + kBlock, rays.along_v);
  double ranges[kBlock];
  const double most = max_range_m / frame_.resolution_m;
  cast(rays, most, ranges);
  if (ranges[0] == kNoExpectation) return kNoExpectation;
  return ranges[0] >= most ? max_range_m : ranges[0] * frame_.resolution_m;
}

}  // namespace mapperd::localization
