// Many voxels changed one by one, written block by block: a block that is opened for each of its
// voxels costs more than the voxels themselves.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "mapperd/voxel_map.hpp"

namespace mapperd {

// The block that holds a voxel within the map's reach.
inline BlockKey block_holding(const VoxelIndex& voxel) {
  const auto block = [](std::int64_t i) { return static_cast<std::int32_t>(i >> kBlockShift); };
  return {block(voxel.x), block(voxel.y), block(voxel.z)};
}

// Changes reach the map when another block is written to, and at flush(): the writer's user ends
// with it. All voxels must lie within the map's reach, all states be observed.
class BlockWriter {
 public:
  explicit BlockWriter(VoxelMap& map) : map_(map) {}

  // The voxel as it stands, with what was written to it.
  VoxelState at(const VoxelIndex& voxel) const;
  void set(const VoxelIndex& voxel, const VoxelState& state);
  void flush();

 private:
  VoxelMap& map_;
  BlockKey key_;
  std::vector<int> written_;                       // offsets
  std::array<VoxelState, kBlockVoxels> states_{};  // count 0 unless written
};

}  // namespace mapperd
