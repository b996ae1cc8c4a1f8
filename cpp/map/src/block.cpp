#include "mapperd/map/block.hpp"

#include <algorithm>
#include <cstring>

#include "mapperd/map/kernels.hpp"
#include "mapperd/common/memory_use.hpp"

namespace mapperd::map {
namespace {

VoxelRows every_voxel() {
  VoxelRows rows;
  rows.fill(0xFFFF);
  return rows;
}

}  // namespace

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
  const bool changed = add_free(rule, every_voxel());
  close(rule);
  return changed;
}

bool Block::add_free(const IwloRule& rule, const VoxelRows& rows) {
  return add_free_steps(rule, rule.one_free_step(), rows);
}

bool Block::add_free_steps(const IwloRule& rule, const IwloRule::FreeSteps& steps,
                           const VoxelRows& rows) {
  const std::int32_t limit = rule.unscaled_up_to();
  const Lowered lowered =
      kernels().lower(dense_->units.data(), dense_->count.data(), rows.data(), steps.down.data(),
                      steps.count.data(), rule.min_units(), limit);
  if (!lowered.any_above) return lowered.changed;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    const bool taken = (rows[i / kBlockEdge] >> (i % kBlockEdge) & 1) != 0;
    if (taken && dense_->units[i] > limit) rule.add_free(dense_->units[i], dense_->count[i]);
  }
  return true;
}

DenseVoxels& Block::open(const IwloRule& rule) {
  if (dense_ == nullptr) {
    dense_ = std::make_unique<DenseVoxels>();
    dense_->units.fill(uniform_.units);
    dense_->count.fill(uniform_.count);
  } else if (pending_ > 0) {
    // Nothing is pending unless every voxel's free steps are unscaled.
    add_free_steps(rule, pending_ == 1 ? rule.one_free_step() : rule.free_steps(pending_),
                   every_voxel());
  }
  pending_ = 0;
  return *dense_;
}

void Block::close(const IwloRule& rule) {
  const auto& units = dense_->units;
  const auto& count = dense_->count;
  const std::int32_t limit = rule.unscaled_up_to();
  std::uint32_t scaled = 0;
  for (const std::int32_t u : units) scaled |= u > limit ? 1U : 0U;
  all_unscaled_ = scaled == 0;
  std::uint32_t known = 0;
  for (const std::uint16_t c : count) known += c != 0 ? 1U : 0U;
  dense_known_ = static_cast<std::uint16_t>(known);
  // Each voxel equals the next.
  const bool alike = std::memcmp(&units[0], &units[1], sizeof units - sizeof units[0]) == 0 &&
                     std::memcmp(&count[0], &count[1], sizeof count - sizeof count[0]) == 0;
  if (!alike) return;
  uniform_ = {units[0], count[0]};
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

void Block::copy_voxels(const IwloRule& rule, DenseVoxels& out) const {
  if (dense_ == nullptr) {
    out.units.fill(uniform_.units);
    out.count.fill(uniform_.count);
    return;
  }
  out = *dense_;
  if (pending_ == 0) return;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    rule.add_unscaled_free(out.units[i], out.count[i], pending_);
  }
}

std::size_t Block::voxel_bytes() const {
  return dense_ == nullptr ? 0 : allocated_bytes(sizeof(DenseVoxels));
}

}  // namespace mapperd::map
