// Many voxels changed one by one, each cell opened once: opening and closing it costs more than
// its voxels.
#pragma once

#include <cstdint>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

// The block that holds a voxel within the map's reach.
inline BlockKey block_holding(const VoxelIndex& voxel) {
  const auto block = [](std::int64_t i) { return static_cast<std::int32_t>(i >> kBlockShift); };
  return {block(voxel.x), block(voxel.y), block(voxel.z)};
}

// Takes voxels in any order, but is quick when those of a block follow each other. All must lie
// within the map's reach, all states be observed and inside the clamps. As long as it lives,
// nobody else may look at the map.
class BlockWriter {
 public:
  explicit BlockWriter(VoxelMap& map) : map_(map), pool_(map.pool()) {}
  ~BlockWriter() { leave(); }
  BlockWriter(const BlockWriter&) = delete;
  BlockWriter& operator=(const BlockWriter&) = delete;

  Voxel at(const VoxelIndex& voxel);
  void set(const VoxelIndex& voxel, const Voxel& state);

 private:
  struct Place {
    CellVoxels cell;
    int voxel;
  };
  Place enter(const VoxelIndex& voxel);
  void leave();

  VoxelMap& map_;
  CellPool::Cache pool_;
  Block* block_ = nullptr;
  CellSet open_ = 0;
};

}  // namespace mapperd::map
