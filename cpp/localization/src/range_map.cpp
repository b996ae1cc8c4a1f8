#include "mapperd/localization/range_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "mapperd/common/parallel.hpp"
#include "mapperd/localization/block_poses.hpp"

namespace mapperd::localization {
namespace {

// Cells; a point this close to an edge ahead counts as beyond it. A ray along an edge is in the
// cell above it, or to its right, as points on the edge are.
constexpr double kAhead = 1e-9;

// Content of one octant of a cell, in a byte.
constexpr std::uint8_t kBlocked = 0;
constexpr std::uint8_t kOnlyHere = 1;  // free; k + 1: and so is the wedge of k columns
constexpr std::uint8_t kMaxWedge = 254;
constexpr std::uint8_t kOutside = 255;

constexpr std::size_t kOctants = 8;

// Directions that lie within 45 degrees: where a ray in them goes, a cell on.
struct Octant {
  bool back_u, back_v, steep;
};

Octant octant(std::size_t index) {
  return {(index & 1U) != 0, (index & 2U) != 0, (index & 4U) != 0};
}

// Of a padded grid, whose border is kOutside and whose blocked cells are kBlocked: how far a ray
// that goes this way from anywhere in a cell stays clear. Each column (row, where it is steep) on,
// it is in the same row or the next; so a wedge is free where its first cells are and both wedges
// of the next column.
void fill_wedges(const Octant& way, std::size_t rows, std::size_t columns, std::uint8_t* plane) {
  const auto stride = static_cast<std::ptrdiff_t>(columns + 2);
  const std::ptrdiff_t right = way.back_u ? -1 : 1;
  const std::ptrdiff_t up = way.back_v ? -stride : stride;
  const std::ptrdiff_t on = way.steep ? up : right;
  const std::ptrdiff_t aside = way.steep ? right : up;
  for (std::size_t k = 0; k < rows; ++k) {
    const std::size_t row = way.back_v ? k + 1 : rows - k;
    std::uint8_t* cell = plane + row * (columns + 2) + (way.back_u ? 1 : columns);
    for (std::size_t i = 0; i < columns; ++i, cell -= right) {
      const std::uint8_t next = std::max(std::min(cell[on], cell[on + aside]), kOnlyHere);
      const std::uint8_t wedge = std::min<std::uint8_t>(next, kMaxWedge - 1) + 1;
      const std::uint8_t clear = cell[aside] == kBlocked ? kOnlyHere : wedge;
      *cell = *cell == kBlocked ? kBlocked : clear;
    }
  }
}

constexpr double kParallel = 1e-12;  // a ray that goes aside by less is parallel to an axis

double without_rounding(double along) { return std::abs(along) > kParallel ? along : 0.0; }

double not_zero(double along) { return along == 0.0 ? kParallel : along; }

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
  std::uint64_t shift[kRays];  // to the byte of the ray's octant
  double found[kRays];         // ranges found in the map
  double moved[kRays];         // 1: went on in the last step
  std::size_t place[kRays];
};

struct Steps {
  const std::uint64_t* cells;
  std::int32_t stride;
  double last_u, last_v;
  double most;
};

constexpr std::uint64_t kWhole = 0x4330000000000000ULL;  // a double whose lowest bits count ones

// One step of all rays; how many went on.
MAPPERD_VECTORISED double step_on(const Steps& steps, March& march) {
  const Steps s = steps;
  double went_on = 0.0;
  for (std::size_t i = 0; i < march.count; ++i) {
    const double gone = march.gone[i];
    const double along_u = march.along_u[i];
    const double along_v = march.along_v[i];
    double u = march.u[i] + gone * along_u + (along_u >= 0.0 ? kAhead : -kAhead);
    double v = march.v[i] + gone * along_v + (along_v >= 0.0 ? kAhead : -kAhead);
    u = u > 0.0 ? u : 0.0;
    v = v > 0.0 ? v : 0.0;
    u = u < s.last_u ? u : s.last_u;
    v = v < s.last_v ? v : s.last_v;
    const auto column = static_cast<std::int32_t>(u);
    const auto row = static_cast<std::int32_t>(v);
    const std::uint64_t here = s.cells[row * s.stride + column] >> march.shift[i];
    const double found = double_of((here & 255U) | kWhole) - double_of(kWhole);
    const double edge_u = static_cast<double>(column) + (along_u >= 0.0 ? 1.0 : 0.0);
    const double edge_v = static_cast<double>(row) + (along_v >= 0.0 ? 1.0 : 0.0);
    const double leave_u = (edge_u - march.u[i]) * march.inverse_u[i];
    const double leave_v = (edge_v - march.v[i]) * march.inverse_v[i];
    const double leave = leave_u < leave_v ? leave_u : leave_v;
    const double a_column = std::abs(march.inverse_u[i]);
    const double a_row = std::abs(march.inverse_v[i]);
    const double wedge =
        a_column <= a_row ? leave_u + (found - 2.0) * a_column : leave_v + (found - 2.0) * a_row;
    double next = leave > wedge ? leave : wedge;
    next = next < s.most ? next : s.most;
    next = found > kBlocked && found < kOutside ? next : gone;
    const double moved = next > gone ? 1.0 : 0.0;
    march.found[i] = found;
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
    march.along_u[i] = without_rounding(rays.along_u[from]);
    march.along_v[i] = without_rounding(rays.along_v[from]);
    march.inverse_u[i] = 1.0 / not_zero(march.along_u[i]);
    march.inverse_v[i] = 1.0 / not_zero(march.along_v[i]);
    const bool steep = std::abs(march.inverse_u[i]) > std::abs(march.inverse_v[i]);
    march.shift[i] = (march.inverse_u[i] < 0.0 ? 8U : 0U) + (march.inverse_v[i] < 0.0 ? 16U : 0U) +
                     (steep ? 32U : 0U);
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
  march.shift[to] = march.shift[from];
  march.gone[to] = march.gone[from];
}

// Writes what is known and keeps the rays that went on.
void keep_moving(March& march, double* out) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < march.count; ++i) {
    const bool outside = march.found[i] == kOutside;
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
  const std::size_t stride = frame_.columns + 2;
  std::vector<std::uint8_t> bounded((frame_.rows + 2) * stride, kOutside);
  for (std::size_t i = 0; i < grid.cells.size(); ++i) {
    const std::int8_t cell = grid.cells[i];
    const bool blocks = cell == kOccupied || (unknown_blocks && cell != kFree);
    const std::size_t row = i / frame_.columns + 1;
    bounded[row * stride + i % frame_.columns + 1] = blocks ? kBlocked : kOnlyHere;
  }
  std::array<std::vector<std::uint8_t>, kOctants> planes;
  run_parallel(kOctants, threads, [&](std::size_t task) {
    planes[task] = bounded;
    fill_wedges(octant(task), frame_.rows, frame_.columns, planes[task].data());
  });
  clear_.resize(bounded.size());
  for (std::size_t i = 0; i < clear_.size(); ++i) {
    std::uint64_t word = 0;
    for (std::size_t k = kOctants; k-- > 0;) word = word << 8U | planes[k][i];
    clear_[i] = word;
  }
}

void RangeMap::cast(const Rays& rays, double most, double* out) const {
  if (rays.count == 0) return;
  March march;
  start(rays, march);
  const Steps steps{clear_.data(), static_cast<std::int32_t>(frame_.columns + 2),
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
  pose_block(&ray.x, &ray.y, &ray.yaw, 1, grid_transform_of(frame_), poses);
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
