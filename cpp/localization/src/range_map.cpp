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

// Two cells lie as far apart as a cell's centre and the nearest of the other and its neighbours.
float step_of(std::int32_t squared) {
  return squared == kBeyond ? 1e6F : std::sqrt(static_cast<float>(squared)) * (1.0F - 1e-6F);
}

// Marks the eight neighbours of marked cells too.
std::vector<std::uint8_t> grown(const std::vector<std::uint8_t>& marked, const GridFrame& frame) {
  std::vector<std::uint8_t> out(marked.size(), 0);
  for (std::size_t i = 0; i < marked.size(); ++i) {
    if (marked[i] == 0) continue;
    const std::size_t row = i / frame.columns;
    const std::size_t column = i % frame.columns;
    const std::size_t last_row = std::min(row + 2, frame.rows);
    const std::size_t last_column = std::min(column + 2, frame.columns);
    for (std::size_t r = row - (row > 0 ? 1 : 0); r < last_row; ++r) {
      for (std::size_t c = column - (column > 0 ? 1 : 0); c < last_column; ++c) {
        out[r * frame.columns + c] = 1;
      }
    }
  }
  return out;
}

double not_zero(double along) {
  if (std::abs(along) > 1e-12) return along;
  return along > 0.0 ? 1e-12 : -1e-12;
}

constexpr std::size_t kLanes = 8;  // rays are worked on in multiples of them

// The rays that are still on their way.
struct March {
  std::size_t count = 0;
  double u[kRays];
  double v[kRays];
  double along_u[kRays];
  double along_v[kRays];
  double inverse_u[kRays];
  double inverse_v[kRays];
  double gone[kRays];
  double found[kRays];  // what the map says there
  double moved[kRays];  // 1: went on in the last step
  std::size_t place[kRays];
};

struct Steps {
  const float* cells;
  std::int32_t stride;
  double last_u, last_v;
  double most;
};

// One step of all rays; how many went on.
LOCALIZATION_VECTORISED double step_on(const Steps& steps, March& march) {
  const Steps s = steps;
  double went_on = 0.0;
  for (std::size_t i = 0; i < march.count; ++i) {
    const double gone = march.gone[i];
    const double along_u = march.along_u[i];
    const double along_v = march.along_v[i];
    double u = march.u[i] + gone * along_u + (along_u > 0.0 ? kAhead : -kAhead);
    double v = march.v[i] + gone * along_v + (along_v > 0.0 ? kAhead : -kAhead);
    u = u > 0.0 ? u : 0.0;
    v = v > 0.0 ? v : 0.0;
    u = u < s.last_u ? u : s.last_u;
    v = v < s.last_v ? v : s.last_v;
    const auto column = static_cast<std::int32_t>(u);
    const auto row = static_cast<std::int32_t>(v);
    const double safe = static_cast<double>(s.cells[row * s.stride + column]);
    const double edge_u = static_cast<double>(column) + (along_u > 0.0 ? 1.0 : 0.0);
    const double edge_v = static_cast<double>(row) + (along_v > 0.0 ? 1.0 : 0.0);
    const double leave_u = (edge_u - march.u[i]) * march.inverse_u[i];
    const double leave_v = (edge_v - march.v[i]) * march.inverse_v[i];
    const double leave = leave_u < leave_v ? leave_u : leave_v;
    const double clear = gone + safe;
    double next = leave > clear ? leave : clear;
    next = next < s.most ? next : s.most;
    next = safe >= 0.0 ? next : gone;
    const double moved = next > gone ? 1.0 : 0.0;
    march.found[i] = safe;
    march.moved[i] = moved;
    march.gone[i] = moved > 0.0 ? next : gone;
  }
  for (std::size_t i = 0; i < march.count; ++i) went_on += march.moved[i];
  return went_on;
}

void start(const Rays& rays, March& march) {
  march.count = (rays.count + kLanes - 1) / kLanes * kLanes;
  for (std::size_t i = 0; i < march.count; ++i) {
    const std::size_t from = std::min(i, rays.count - 1);  // the last ones are filled up
    march.place[i] = from;
    march.u[i] = rays.u[from];
    march.v[i] = rays.v[from];
    march.along_u[i] = rays.along_u[from];
    march.along_v[i] = rays.along_v[from];
    march.inverse_u[i] = 1.0 / not_zero(rays.along_u[from]);
    march.inverse_v[i] = 1.0 / not_zero(rays.along_v[from]);
    march.gone[i] = 0.0;
  }
}

void copy(March& march, std::size_t from, std::size_t to) {
  march.place[to] = march.place[from];
  march.u[to] = march.u[from];
  march.v[to] = march.v[from];
  march.along_u[to] = march.along_u[from];
  march.along_v[to] = march.along_v[from];
  march.inverse_u[to] = march.inverse_u[from];
  march.inverse_v[to] = march.inverse_v[from];
  march.gone[to] = march.gone[from];
}

// Writes what is known and keeps the rays that went on.
void keep_moving(March& march, double* out) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < march.count; ++i) {
    const bool outside = march.found[i] == static_cast<double>(kOutside);
    out[march.place[i]] = outside ? kNoExpectation : march.gone[i];
    copy(march, i, kept);
    kept += march.moved[i] > 0.0 ? 1 : 0;
  }
  march.count = kept;
  if (kept == 0) return;
  for (; march.count % kLanes != 0; ++march.count) copy(march, kept - 1, march.count);
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
      squared_distances(grown(blocks, frame_), frame_.rows, frame_.columns, 1 << 19, threads);
  steps_.assign((frame_.rows + 2) * (frame_.columns + 2), kOutside);
  for (std::size_t r = 0; r < frame_.rows; ++r) {
    const std::size_t from = r * frame_.columns;
    float* to = &steps_[(r + 1) * (frame_.columns + 2) + 1];
    for (std::size_t c = 0; c < frame_.columns; ++c) {
      to[c] = blocks[from + c] != 0 ? kBlocked : step_of(squared[from + c]);
    }
  }
}

void RangeMap::cast(const Rays& rays, double most, double* out) const {
  if (rays.count == 0) return;
  March march;
  start(rays, march);
  const Steps steps{steps_.data(), static_cast<std::int32_t>(frame_.columns + 2),
                    static_cast<double>(frame_.columns) + 1.0,
                    static_cast<double>(frame_.rows) + 1.0, most};
  while (march.count > 0) {
    const double on = step_on(steps, march);
    // To sort out the rays costs about as much as a step of them.
    if (on <= 0.75 * static_cast<double>(march.count)) keep_moving(march, out);
  }
}

double RangeMap::cast(const Pose2& ray, double max_range_m) const {
  BlockPoses poses;
  pose_block(&ray.x, &ray.y, &ray.yaw, 1, lattice_of(frame_), poses);
  Rays rays;
  rays.count = 1;
  rays.u[0] = poses.u[0];
  rays.v[0] = poses.v[0];
  rays.along_u[0] = poses.cosine[0];
  rays.along_v[0] = poses.sine[0];
  double ranges[1];
  const double most = max_range_m / frame_.resolution_m;
  cast(rays, most, ranges);
  if (ranges[0] == kNoExpectation) return kNoExpectation;
  return ranges[0] >= most ? max_range_m : ranges[0] * frame_.resolution_m;
}

}  // namespace mapperd::localization
