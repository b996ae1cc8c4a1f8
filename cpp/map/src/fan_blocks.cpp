#include "mapperd/map/fan_blocks.hpp"

namespace mapperd::map {
namespace {

// By how much, in voxels, what a moving sonar sees of a block may depart from a linear function of
// the place.
constexpr double kMaxBend = 0.05;

}  // namespace

std::vector<BlockCube> FanBlocks::cubes() const {
  std::vector<BlockCube> cubes;
  int blocks = kCubeBlocks;
  while (blocks * block_m_ < 1.02 * grid_.reach_m() + block_m_) blocks *= 2;
  for (int octant = 0; octant < 8; ++octant) {
    const auto low = [&](int bit) { return (octant >> bit & 1) != 0 ? 0 : -blocks; };
    visit(
        {{low(0), low(1), low(2)}, blocks}, [&](const BlockCube& cube) { cubes.push_back(cube); },
        kCubeBlocks);
  }
  return cubes;
}

void FanBlocks::fetch(VoxelMap& map, const std::vector<BlockCube>& cubes) const {
  if (!map.residency().is_partial()) return;
  std::vector<BlockKey> blocks;
  for (const BlockCube& cube : cubes) {
    visit(
        cube,
        [&](const BlockCube& block) {
          if (classes_of(view_of(block)) != kHasNothing) blocks.push_back(absolute(block.first));
        },
        1);
  }
  map.residency().fetch(blocks);
}

Vec3 FanBlocks::centre_of(const BlockCube& cube) const {
  const double half = 0.5 * cube.blocks;
  return Vec3{(cube.first.x + half) * block_m_, (cube.first.y + half) * block_m_,
              (cube.first.z + half) * block_m_} -
         start_.block_T_sonar.translation;
}

// Whether a cube shares space with the fan, by the ball around it.
bool FanBlocks::may_be_seen(const BlockCube& cube) const {
  const BlockKey low = absolute(cube.first);
  const int rest = cube.blocks - 1;
  if (!map_.limit().meets(low, {low.x + rest, low.y + rest, low.z + rest})) return false;
  const Vec3 centre = centre_of(cube);
  double radius = 0.8661 * cube.blocks * block_m_;
  Vec3 seen = centre;
  if (view_) {
    const MotionBound bound = view_->motion_bound(centre, radius);
    seen = view_->seen(centre);
    radius += 2 * bound.stretch * radius;
  }
  const Vec3 v = to_sonar(seen);
  const double reach = radius + edge_m_;  // of footprints, and beyond the aperture's faces
  const double horizontal = std::sqrt(v.x * v.x + v.y * v.y);
  const double range = std::sqrt(horizontal * horizontal + v.z * v.z);
  return range - radius < grid_.reach_m() && range + reach > grid_.min_range_m() &&
         horizontal * grid_.sin_half_aperture() - std::abs(v.z) * grid_.cos_half_aperture() >
             -reach &&
         v.x > -radius && dot(v, low_side_) > -reach && dot(v, high_side_) > -reach;
}

BlockView FanBlocks::view_of(const BlockCube& block) const {
  BlockView view{centre_of(block), {}, {}, true};
  Vec3 seen = view.centre;
  SeenAxes axes;
  if (view_) {
    const Seen apparent = view_->look(view.centre);
    seen = apparent.at;
    axes = apparent.axes;
    view.is_linear = view_->motion_bound(view.centre, 0.8661 * block_m_).bend <= kMaxBend * edge_m_;
  }
  view.seen = (1.0 / edge_m_) * to_sonar(seen);
  view.step = {to_sonar(axes.x), to_sonar(axes.y), to_sonar(axes.z)};
  return view;
}

// Classes of evidence that the block may hold.
std::uint8_t FanBlocks::classes_of(const BlockView& view) const {
  const Vec3& v = view.seen;
  const double horizontal = std::max(std::sqrt(v.x * v.x + v.y * v.y), 1e-12);
  return grid_.classes_of_block(edge_m_ * std::sqrt(horizontal * horizontal + v.z * v.z),
                                -v.y / horizontal);
}

void FanBlocks::places_of(const BlockView& view, int cell, CellPoints& points) const {
  static_assert(CellPoints::kCount == kCellVoxels);
  const int corner = offset_of_cell(cell);
  for (int v = 0; v < kCellVoxels; ++v) {
    const int offset = corner + offset_in_cell(v);
    const auto from_middle = [](int at) { return at - (kBlockEdge - 1) / 2.0; };
    points.set(static_cast<std::size_t>(v),
               view.centre + edge_m_ * Vec3{from_middle(offset & 15), from_middle(offset >> 4 & 15),
                                            from_middle(offset >> 8)});
  }
  if (view_) view_->see(points);
  for (std::size_t v = 0; v < CellPoints::kCount; ++v) points.set(v, to_sonar(points.at(v)));
}

}  // namespace mapperd::map
