#include "mapperd/block.hpp"

#include <algorithm>

#include "mapperd/memory_use.hpp"

namespace mapperd {
bool Block::add_free_everywhere(const IwloRule& rule) {
  if (dense_ == nullptr) {
    const Voxel before = uniform_;
    rule.add_free(uniform_.units, uniform_.count);
    return uniform_.units != before.units || uniform_.count != before.count;
  }
  if (all_unscaled_) {
    ++pending_;
    if (pending_ >= rule.free_steps_to_floor()) {  // all voxels are alike by now
      open(rule);
      close(rule);
    }
    return true;
  }
  for (std::size_t i = 0; i < kBlockVoxels; ++i) rule.add_free(dense_->units[i], dense_->count[i]);
  close(rule);
  return true;
}

DenseVoxels& Block::open(const IwloRule& rule) {
  if (dense_ == nullptr) {
    dense_ = std::make_unique<DenseVoxels>();
    dense_->units.fill(uniform_.units);
    dense_->count.fill(uniform_.count);
  } else if (pending_ > 0) {
    for (std::size_t i = 0; i < kBlockVoxels; ++i) {
      rule.add_unscaled_free(dense_->units[i], dense_->count[i], pending_);
    }
  }
  pending_ = 0;
  return *dense_;
}

void Block::close(const IwloRule& rule) {
  const auto& units = dense_->units;
  const auto& count = dense_->count;
  const Voxel first{units[0], count[0]};
  std::int32_t highest = units[0];
  bool alike = true;
  int known = 0;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    highest = std::max(highest, units[i]);
    known += count[i] != 0 ? 1 : 0;
    alike = alike && units[i] == first.units && count[i] == first.count;
  }
  all_unscaled_ = rule.is_unscaled(highest);
  dense_known_ = static_cast<std::uint16_t>(known);
  if (!alike) return;
  uniform_ = first;
  dense_.reset();
}

void Block::fill(const Voxel& voxel) {
  uniform_ = voxel;
  pending_ = 0;
  dense_.reset();
}

int Block::known_count() const {
  if (dense_ == nullptr) return uniform_.count != 0 ? kBlockVoxels : 0;
  return pending_ > 0 ? kBlockVoxels : dense_known_;
}

Voxel Block::voxel(const IwloRule& rule, int offset) const {
  if (dense_ == nullptr) return uniform_;
  const auto i = static_cast<std::size_t>(offset);
  Voxel voxel{dense_->units[i], dense_->count[i]};
  if (pending_ > 0) rule.add_unscaled_free(voxel.units, voxel.count, pending_);
  return voxel;
}

std::size_t Block::voxel_bytes() const {
  return dense_ == nullptr ? 0 : allocated_bytes(sizeof(DenseVoxels));
}

}  // namespace mapperd
