#include "mapperd/map/distance_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

namespace mapperd::map {
namespace {

// A squared distance in voxels. The box with its margin is at least 2 margin + 1 voxels wide along
// each axis, and kMaxBoxVoxels = 2^27 of them limit the margin to 255: 255^2 fits.
using Squared = std::uint16_t;
constexpr Squared kFar = std::numeric_limits<Squared>::max();
constexpr std::int64_t kMaxMargin = 255;

std::int64_t floor_divide(std::int64_t a, std::int64_t b) {  // b > 0
  return a >= 0 ? a / b : -((-a + b - 1) / b);
}

// Lower envelope of the parabolas (i - site)^2 + height(site) over one line.
class Envelope {
 public:
  // `height` holds kFar where there is no site.
  void build(const std::vector<Squared>& height) {
    pieces_.clear();
    for (std::size_t i = 0; i < height.size(); ++i) {
      if (height[i] != kFar) add(static_cast<std::int64_t>(i), height[i]);
    }
  }

  // Squared distances at `first`, first + 1, ...; those beyond `limit` are kFar.
  void read(std::int64_t first, std::int64_t limit, std::vector<Squared>& line) const {
    std::fill(line.begin(), line.end(), kFar);
    std::size_t k = 0;
    for (std::size_t i = 0; i < line.size() && !pieces_.empty(); ++i) {
      const std::int64_t at = first + static_cast<std::int64_t>(i);
      while (k + 1 < pieces_.size() && pieces_[k + 1].from <= at) ++k;
      const std::int64_t offset = at - pieces_[k].site;
      const std::int64_t value = offset * offset + pieces_[k].height;
      if (value <= limit) line[i] = static_cast<Squared>(value);
    }
  }

 private:
  struct Piece {
    std::int64_t site;
    std::int64_t height;
    std::int64_t from;  // first index where this parabola is the lowest
  };

  void add(std::int64_t site, std::int64_t height) {
    while (!pieces_.empty()) {
      const Piece& last = pieces_.back();
      // Up to this index the last parabola is not above the new one.
      const std::int64_t shared = floor_divide(
          site * site - last.site * last.site + height - last.height, 2 * (site - last.site));
      if (shared >= last.from) {
        pieces_.push_back({site, height, shared + 1});
        return;
      }
      pieces_.pop_back();
    }
    pieces_.push_back({site, height, 0});
  }

  std::vector<Piece> pieces_;
};

// A dense array of three axes, the last fastest.
struct Grid {
  std::array<std::size_t, 3> size;
  std::vector<Squared> cells;

  std::size_t stride(std::size_t axis) const {
    std::size_t product = 1;
    for (std::size_t faster = axis + 1; faster < size.size(); ++faster) product *= size[faster];
    return product;
  }
};

// Takes the minimum along one axis and cuts the margin off it.
Grid transformed(const Grid& in, std::size_t axis, std::int64_t margin) {
  Grid out{in.size, {}};
  out.size[axis] -= 2 * static_cast<std::size_t>(margin);
  out.cells.resize(out.size[0] * out.size[1] * out.size[2]);
  const std::size_t stride = in.stride(axis);  // the same in both: only faster axes count
  std::vector<Squared> line_in(in.size[axis]);
  std::vector<Squared> line_out(out.size[axis]);
  Envelope envelope;
  const std::size_t outer_count = out.cells.size() / (stride * out.size[axis]);
  for (std::size_t outer = 0; outer < outer_count; ++outer) {
    for (std::size_t inner = 0; inner < stride; ++inner) {
      const Squared* from = &in.cells[outer * stride * line_in.size() + inner];
      for (std::size_t i = 0; i < line_in.size(); ++i) line_in[i] = from[i * stride];
      envelope.build(line_in);
      envelope.read(margin, margin * margin, line_out);
      Squared* to = &out.cells[outer * stride * line_out.size() + inner];
      for (std::size_t i = 0; i < line_out.size(); ++i) to[i * stride] = line_out[i];
    }
  }
  return out;
}

std::int64_t checked_margin(double max_distance_m, double resolution_m) {
  if (!(max_distance_m > 0)) throw std::invalid_argument("max_distance_m must be above 0");
  const double voxels = std::ceil(max_distance_m / resolution_m);
  if (!(voxels <= static_cast<double>(kMaxMargin))) {
    throw std::invalid_argument("max_distance_m must be at most 255 voxels");
  }
  return static_cast<std::int64_t>(voxels);
}

}  // namespace

std::vector<float> distance_field(const VoxelMap& map, const VoxelBox& box, double max_distance_m,
                                  double occupied_log_odds) {
  if (std::isnan(occupied_log_odds)) {
    throw std::invalid_argument("occupied_log_odds must be a number");
  }
  const std::int64_t margin = checked_margin(max_distance_m, map.resolution_m());
  if (box.count() == 0) return {};
  const VoxelBox around = box.grown(margin);
  check_dense(around);
  Grid grid{{static_cast<std::size_t>(around.size[0]), static_cast<std::size_t>(around.size[1]),
             static_cast<std::size_t>(around.size[2])},
            std::vector<Squared>(around.count(), kFar)};
  {
    const ReadLock lock(map);
    for_each_known_in(map, around, [&](const VoxelIndex& voxel, const VoxelState& state) {
      if (state.log_odds > occupied_log_odds) grid.cells[around.place_of(voxel)] = 0;
    });
  }
  for (const std::size_t axis : {2U, 1U, 0U}) grid = transformed(grid, axis, margin);
  std::vector<float> distances(grid.cells.size());
  std::transform(grid.cells.begin(), grid.cells.end(), distances.begin(), [&](Squared squared) {
    if (squared == kFar) return static_cast<float>(max_distance_m);
    const double distance_m = std::sqrt(static_cast<double>(squared)) * map.resolution_m();
    return static_cast<float>(std::min(distance_m, max_distance_m));
  });
  return distances;
}

}  // namespace mapperd::map
