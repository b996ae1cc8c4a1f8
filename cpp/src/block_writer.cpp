#include "mapperd/block_writer.hpp"

namespace mapperd {
namespace {

// So few voxels are set faster one by one.
constexpr std::size_t kFew = 3;

int offset_in_block(const VoxelIndex& voxel) {
  const auto local = [](std::int64_t i) { return static_cast<int>(i & (kBlockEdge - 1)); };
  return voxel_offset(local(voxel.x), local(voxel.y), local(voxel.z));
}

}  // namespace

VoxelState BlockWriter::at(const VoxelIndex& voxel) const {
  if (!written_.empty() && block_holding(voxel) == key_) {
    const VoxelState& state = states_[static_cast<std::size_t>(offset_in_block(voxel))];
    if (state.count != 0) return state;
  }
  return map_.at(voxel);
}

void BlockWriter::set(const VoxelIndex& voxel, const VoxelState& state) {
  const BlockKey key = block_holding(voxel);
  if (!(key == key_)) flush();
  key_ = key;
  const int offset = offset_in_block(voxel);
  VoxelState& slot = states_[static_cast<std::size_t>(offset)];
  if (slot.count == 0) written_.push_back(offset);
  slot = state;
}

void BlockWriter::flush() {
  if (written_.size() > kFew) {
    map_.set_block(key_, states_);
  } else {
    for (const int offset : written_) {
      map_.set(VoxelMap::index_of(key_, offset), states_[static_cast<std::size_t>(offset)]);
    }
  }
  for (const int offset : written_) states_[static_cast<std::size_t>(offset)] = {};
  written_.clear();
}

}  // namespace mapperd
