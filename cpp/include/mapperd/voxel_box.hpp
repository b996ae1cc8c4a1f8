// Boxes of voxels: what a question about a region of the map is about.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "mapperd/vec.hpp"
#include "mapperd/voxel_map.hpp"

namespace mapperd {

// Answers are dense grids, and nobody means to ask for more voxels than this at once.
inline constexpr std::size_t kMaxBoxVoxels = std::size_t{1} << 27U;

// Voxels first.x .. first.x + size[0] - 1, and so on; a size may be 0.
struct VoxelBox {
  VoxelIndex first;
  std::array<std::int64_t, 3> size{};

  // Voxels in the box; saturates.
  std::size_t count() const;
  bool contains(const VoxelIndex& voxel) const;

  // Place in a dense grid, z fastest, of a voxel that the box contains.
  std::size_t place_of(const VoxelIndex& voxel) const {
    const std::int64_t row = (voxel.x - first.x) * size[1] + (voxel.y - first.y);
    return static_cast<std::size_t>(row * size[2] + (voxel.z - first.z));
  }

  // The box and `voxels` more on every side.
  VoxelBox grown(std::int64_t voxels) const;
};

// All voxels whose centres lie in low <= centre < high: boxes side by side share none.
// Throws std::invalid_argument for corners that are not finite, not in order, or beyond the reach.
VoxelBox box_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m);

// The same, of x and y alone, in the one layer that holds the height z_m.
VoxelBox layer_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m, double z_m);

// Throws std::invalid_argument when the box holds more than kMaxBoxVoxels.
void check_dense(const VoxelBox& box);

namespace detail {

// Visits a box block by block, in the map's canonical order.
template <typename Visit>
void for_each_voxel_of(const VoxelBox& box, const Visit& visit) {
  const VoxelIndex& low = box.first;
  const VoxelIndex high{low.x + box.size[0], low.y + box.size[1], low.z + box.size[2]};
  // First voxel of the block after the one that holds `i`, but not beyond `end`.
  const auto next_block = [](std::int64_t i, std::int64_t end) {
    const std::int64_t local = (i % kBlockEdge + kBlockEdge) % kBlockEdge;
    return std::min(i - local + kBlockEdge, end);
  };
  for (std::int64_t bx = low.x; bx < high.x; bx = next_block(bx, high.x)) {
    for (std::int64_t by = low.y; by < high.y; by = next_block(by, high.y)) {
      for (std::int64_t bz = low.z; bz < high.z; bz = next_block(bz, high.z)) {
        for (std::int64_t z = bz; z < next_block(bz, high.z); ++z) {
          for (std::int64_t y = by; y < next_block(by, high.y); ++y) {
            for (std::int64_t x = bx; x < next_block(bx, high.x); ++x) visit(VoxelIndex{x, y, z});
          }
        }
      }
    }
  }
}

}  // namespace detail

// Visits the observed voxels of a box, in the map's canonical order. Walks the box or the map,
// whichever is smaller.
template <typename Visit>  // void(const VoxelIndex&, const VoxelState&)
void for_each_known_in(const VoxelMap& map, const VoxelBox& box, const Visit& visit) {
  if (box.count() <= map.block_count() * std::size_t{kBlockVoxels}) {
    detail::for_each_voxel_of(box, [&](const VoxelIndex& voxel) {
      const VoxelState state = map.at(voxel);
      if (state.count != 0) visit(voxel, state);
    });
    return;
  }
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    if (box.contains(voxel)) visit(voxel, state);
  });
}

}  // namespace mapperd
