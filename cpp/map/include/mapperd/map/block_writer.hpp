/// \file
/// \brief Writes many voxels one by one and opens each cell once, because opening and closing cost
/// more than writing its voxels.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <cstdint>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// The block that holds a voxel within the map's reach.
inline BlockKey block_holding(const VoxelIndex& voxel) {
  const auto block = [](std::int64_t i) { return static_cast<std::int32_t>(i >> kBlockShift); };
  return {block(voxel.x), block(voxel.y), block(voxel.z)};
}

/// Takes voxels in any order, and is fastest if those of a block follow each other. All must lie
/// within the map's reach, and all states must be observed and within the clamps. No other thread
/// may use the map during its lifetime.
class BlockWriter {
 public:
  explicit BlockWriter(VoxelMap& map) : map_(map), pool_(map.pool()) {}
  ~BlockWriter() { leave(); }
  BlockWriter(const BlockWriter&) = delete;
  BlockWriter& operator=(const BlockWriter&) = delete;

  Voxel at(const VoxelIndex& voxel);
  void set(const VoxelIndex& voxel, const Voxel& state);

 private:
  struct VoxelPlace {
    CellVoxels cell;
    int voxel;
  };
  VoxelPlace enter(const VoxelIndex& voxel);
  void leave();

  VoxelMap& map_;
  CellPool::Cache pool_;
  Block* block_ = nullptr;
  CellSet open_ = 0;
};

}  // namespace mapperd::map
