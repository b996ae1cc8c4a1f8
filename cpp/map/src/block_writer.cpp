#include "mapperd/map/block_writer.hpp"

namespace mapperd::map {

Voxel BlockWriter::at(const VoxelIndex& voxel) {
  const VoxelPlace at = enter(voxel);
  return {at.cell.units()[at.voxel], at.cell.count(at.voxel)};
}

void BlockWriter::set(const VoxelIndex& voxel, const Voxel& state) {
  const VoxelPlace at = enter(voxel);
  at.cell.units()[at.voxel] = state.units;
  at.cell.set_count(at.voxel, state.count);
}

BlockWriter::VoxelPlace BlockWriter::enter(const VoxelIndex& voxel) {
  const BlockKey key = block_holding(voxel);
  if (block_ == nullptr || !(block_->key == key)) {
    leave();
    block_ = &map_.get_or_create(key);
  }
  const auto local = [](std::int64_t i) { return static_cast<int>(i & (kBlockEdge - 1)); };
  const CellPlace at = cell_place(voxel_offset(local(voxel.x), local(voxel.y), local(voxel.z)));
  open_ |= cell_bit(at.cell);
  return {block_->open(map_.rule(), pool_, at.cell), at.voxel};
}

void BlockWriter::leave() {
  if (block_ == nullptr) return;
  for (; open_ != 0; open_ &= open_ - 1) {
    block_->close(map_.rule(), pool_, __builtin_ctzll(open_));
  }
  block_->revision = map_.next_revision();
  block_ = nullptr;
}

}  // namespace mapperd::map
