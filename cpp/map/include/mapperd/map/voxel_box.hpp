/// \file
/// \brief Boxes of voxels, for queries of a region of the map.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Largest number of voxels in a query with a dense result.
inline constexpr std::size_t kMaxBoxVoxels = std::size_t{1} << 27U;

/// Voxels first.x .. first.x + size[0] - 1, and so on; a size may be 0.
struct VoxelBox {
  VoxelIndex first;
  std::array<std::int64_t, 3> size{};

  /// Number of voxels in the box; saturates.
  std::size_t count() const;
  bool contains(const VoxelIndex& voxel) const;

  /// Place in a dense grid, z fastest, of a voxel that the box contains.
  std::size_t place_of(const VoxelIndex& voxel) const {
    const std::int64_t row = (voxel.x - first.x) * size[1] + (voxel.y - first.y);
    return static_cast<std::size_t>(row * size[2] + (voxel.z - first.z));
  }

  /// Returns the box enlarged by `voxels` on every side.
  VoxelBox grown(std::int64_t voxels) const;
};

/// Returns the box of all voxels with low <= centre < high (map frame, m): adjacent boxes share
/// none.
/// \throws std::invalid_argument for corners that are not finite, not in order, or beyond the
/// reach.
VoxelBox box_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m);

/// Returns the box between low and high in x and y, one voxel thick at the height z_m.
VoxelBox layer_of(const VoxelMap& map, const Vec3& low_m, const Vec3& high_m, double z_m);

/// \throws std::invalid_argument when the box holds more than kMaxBoxVoxels.
void check_dense(const VoxelBox& box);

namespace detail {

/// The box that holds all blocks which share voxels with a box of voxels, in blocks.
inline VoxelBox blocks_of(const VoxelBox& box) {
  const auto first = [](std::int64_t i) { return i >> kBlockShift; };
  const auto span = [](std::int64_t i, std::int64_t size) {
    return size == 0 ? 0 : ((i + size - 1) >> kBlockShift) - (i >> kBlockShift) + 1;
  };
  return {{first(box.first.x), first(box.first.y), first(box.first.z)},
          {span(box.first.x, box.size[0]), span(box.first.y, box.size[1]),
           span(box.first.z, box.size[2])}};
}

/// Visits the observed voxels that a block shares with a box.
template <typename Visit>
void for_each_known_of(const VoxelMap& map, const Block& block, const VoxelBox& box,
                       const Visit& visit) {
  const VoxelIndex corner = VoxelMap::index_of(block.key, 0);
  const auto from = [](std::int64_t low, std::int64_t begin) {
    return static_cast<int>(std::clamp<std::int64_t>(low - begin, 0, kBlockEdge));
  };
  const int x_end = from(box.first.x + box.size[0], corner.x);
  const int y_end = from(box.first.y + box.size[1], corner.y);
  const int z_end = from(box.first.z + box.size[2], corner.z);
  for (int z = from(box.first.z, corner.z); z < z_end; ++z) {
    for (int y = from(box.first.y, corner.y); y < y_end; ++y) {
      for (int x = from(box.first.x, corner.x); x < x_end; ++x) {
        const Voxel voxel = map.voxel(block, voxel_offset(x, y, z));
        if (voxel.count == 0) continue;
        visit(VoxelIndex{corner.x + x, corner.y + y, corner.z + z}, map.state_of(voxel));
      }
    }
  }
}

}  // namespace detail

/// Visits the observed voxels of a box, in the map's canonical order. Looks up the blocks of the
/// box, or goes through those of the map, whichever are fewer.
template <typename Visit>  // void(const VoxelIndex&, const VoxelState&)
void for_each_known_in(const VoxelMap& map, const VoxelBox& box, const Visit& visit) {
  const VoxelBox blocks = detail::blocks_of(box);
  if (blocks.count() > map.block_count()) {
    for (const Block* block : map.sorted_blocks()) {
      const BlockKey& key = block->key;
      if (!blocks.contains({key.x, key.y, key.z})) continue;
      detail::for_each_known_of(map, *block, box, visit);
    }
    return;
  }
  const VoxelIndex& low = blocks.first;
  for (std::int64_t x = low.x; x < low.x + blocks.size[0]; ++x) {
    for (std::int64_t y = low.y; y < low.y + blocks.size[1]; ++y) {
      for (std::int64_t z = low.z; z < low.z + blocks.size[2]; ++z) {
        const Block* block = map.find({static_cast<std::int32_t>(x), static_cast<std::int32_t>(y),
                                       static_cast<std::int32_t>(z)});
        if (block != nullptr) detail::for_each_known_of(map, *block, box, visit);
      }
    }
  }
}

}  // namespace mapperd::map
