#include "mapperd/map/voxel_box.hpp"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

namespace mapperd::map {
namespace {

// Index of the first voxel whose centre is at `position_m` or above.
std::int64_t first_centre_from(double position_m, double resolution_m) {
  const double index = std::ceil(position_m / resolution_m - 0.5);
  // The negation also refuses what is not finite.
  if (!(std::abs(index) < static_cast<double>(kMaxBlock) * kBlockEdge)) {
    throw std::invalid_argument("a corner of the box is not finite or beyond the map's reach");
  }
  return static_cast<std::int64_t>(index);
}

}  // namespace

std::size_t VoxelBox::count() const {
  std::size_t product = 1;
  for (const std::int64_t edge : size) {
    const auto voxels = static_cast<std::size_t>(edge);
    if (voxels == 0) return 0;
    if (product > std::numeric_limits<std::size_t>::max() / voxels) {
      product = std::numeric_limits<std::size_t>::max();
    } else {
      product *= voxels;
    }
  }
  return product;
}

bool VoxelBox::contains(const VoxelIndex& voxel) const {
  const auto inside = [](std::int64_t i, std::int64_t low, std::int64_t length) {
    return i >= low && i - low < length;
  };
  return inside(voxel.x, first.x, size[0]) && inside(voxel.y, first.y, size[1]) &&
         inside(voxel.z, first.z, size[2]);
}

VoxelBox VoxelBox::grown(std::int64_t voxels) const {
  return {{first.x - voxels, first.y - voxels, first.z - voxels},
          {size[0] + 2 * voxels, size[1] + 2 * voxels, size[2] + 2 * voxels}};
}

VoxelBox box_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m) {
  if (!(low_m.x <= high_m.x && low_m.y <= high_m.y && low_m.z <= high_m.z)) {
    throw std::invalid_argument("a box needs numbers as corners, the low one below the high one");
  }
  const double edge = map.resolution_m();
  const VoxelIndex first{first_centre_from(low_m.x, edge), first_centre_from(low_m.y, edge),
                         first_centre_from(low_m.z, edge)};
  return {first,
          {first_centre_from(high_m.x, edge) - first.x, first_centre_from(high_m.y, edge) - first.y,
           first_centre_from(high_m.z, edge) - first.z}};
}

VoxelBox layer_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m, double z_m) {
  VoxelBox box = box_of(map, {low_m.x, low_m.y, 0.0}, {high_m.x, high_m.y, 0.0});
  VoxelIndex layer;
  if (!map.index_of({0.0, 0.0, z_m}, layer)) {
    throw std::invalid_argument("the height is not finite or beyond the map's reach");
  }
  box.first.z = layer.z;
  box.size[2] = 1;
  return box;
}

void check_dense(const VoxelBox& box) {
  if (box.count() <= kMaxBoxVoxels) return;
  const auto& s = box.size;
  throw std::invalid_argument("a box of " + std::to_string(s[0]) + " x " + std::to_string(s[1]) +
                              " x " + std::to_string(s[2]) + " voxels holds more than " +
                              std::to_string(kMaxBoxVoxels) + ": ask for a smaller one");
}

}  // namespace mapperd::map
