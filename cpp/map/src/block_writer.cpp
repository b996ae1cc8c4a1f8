#include "mapperd/map/block_writer.hpp"

namespace mapperd::map {

Voxel BlockWriter::at(const VoxelIndex& voxel) {
  const std::size_t offset = enter(voxel);
  return {voxels_->units[offset], voxels_->count[offset]};
}

void BlockWriter::set(const VoxelIndex& voxel, const Voxel& state) {
  const std::size_t offset = enter(voxel);
  voxels_->units[offset] = state.units;
  voxels_->count[offset] = state.count;
}

std::size_t BlockWriter::enter(const VoxelIndex& voxel) {
  const BlockKey key = block_holding(voxel);
  if (block_ == nullptr || !(block_->key == key)) {
    leave();
    Block& block = map_.get_or_create(key);
    voxels_ = &block.open(map_.rule());
    block_ = &block;
  }
  const auto local = [](std::int64_t i) { return static_cast<int>(i & (kBlockEdge - 1)); };
  return static_cast<std::size_t>(voxel_offset(local(voxel.x), local(voxel.y), local(voxel.z)));
}

void BlockWriter::leave() {
  if (block_ == nullptr) return;
  block_->close(map_.rule());
  block_->revision = map_.next_revision();
  block_ = nullptr;
}

}  // namespace mapperd::map
