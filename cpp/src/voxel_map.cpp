#include "mapperd/voxel_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace mapperd {
namespace {

constexpr std::size_t kFirstSlots = 1024;

// Mixes three 32-bit coordinates; the constants are those of the MurmurHash3 finaliser.
std::uint64_t hash_of(const BlockKey& key) {
  auto mix = [](std::uint64_t h) {
    h ^= h >> 33U;
    h *= 0xff51afd7ed558ccdULL;
    h ^= h >> 33U;
    h *= 0xc4ceb9fe1a85ec53ULL;
    return h ^ (h >> 33U);
  };
  const auto xy = (static_cast<std::uint64_t>(static_cast<std::uint32_t>(key.x)) << 32U) |
                  static_cast<std::uint32_t>(key.y);
  return mix(mix(xy) + static_cast<std::uint32_t>(key.z));
}

bool in_reach(const BlockKey& key) {
  const auto ok = [](std::int32_t v) { return v >= -kMaxBlock && v <= kMaxBlock; };
  return ok(key.x) && ok(key.y) && ok(key.z);
}

}  // namespace

VoxelMap::VoxelMap(double resolution_m, const IwloParams& iwlo)
    : resolution_m_(resolution_m), rule_(iwlo), slots_(kFirstSlots, kEmpty) {
  if (!(std::isfinite(resolution_m) && resolution_m >= 1e-4 && resolution_m <= 1e4)) {
    throw std::invalid_argument("resolution_m must lie between 0.0001 and 10000 m");
  }
}

std::size_t VoxelMap::memory_bytes() const {
  // A deque of elements larger than its node size holds one element and one pointer a node.
  return blocks_.size() * (sizeof(Block) + sizeof(Block*)) +
         slots_.capacity() * sizeof(std::uint32_t) + sizeof(VoxelMap);
}

std::size_t VoxelMap::slot_of(const BlockKey& key) const {
  const std::size_t mask = slots_.size() - 1;
  std::size_t slot = hash_of(key) & mask;
  while (slots_[slot] != kEmpty && !(blocks_[slots_[slot]].key == key)) slot = (slot + 1) & mask;
  return slot;
}

void VoxelMap::grow() {
  slots_.assign(slots_.size() * 2, kEmpty);
  std::uint32_t index = 0;
  for (const Block& block : blocks_) slots_[slot_of(block.key)] = index++;
}

Block& VoxelMap::get_or_create(const BlockKey& key) {
  if (!in_reach(key)) throw std::out_of_range("the block lies beyond the map's reach");
  const std::size_t slot = slot_of(key);
  if (slots_[slot] != kEmpty) return blocks_[slots_[slot]];
  slots_[slot] = static_cast<std::uint32_t>(blocks_.size());
  blocks_.emplace_back(key);
  if (2 * blocks_.size() > slots_.size()) grow();
  return blocks_.back();
}

const Block* VoxelMap::find(const BlockKey& key) const {
  const std::size_t slot = slot_of(key);
  return slots_[slot] == kEmpty ? nullptr : &blocks_[slots_[slot]];
}

VoxelState VoxelMap::at(const Vec3& point_m) const {
  const std::array<double, 3> point{point_m.x, point_m.y, point_m.z};
  std::array<std::int32_t, 3> block{};
  std::array<int, 3> local{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double index = std::floor(point[i] / resolution_m_);
    if (!(std::abs(index) < static_cast<double>(kMaxBlock) * kBlockEdge)) return {};
    const auto voxel = static_cast<std::int64_t>(index);
    block[i] = static_cast<std::int32_t>(voxel >> 3);
    local[i] = static_cast<int>(voxel & (kBlockEdge - 1));
  }
  const Block* found = find({block[0], block[1], block[2]});
  if (found == nullptr) return {};
  const auto offset = static_cast<std::size_t>(voxel_offset(local[0], local[1], local[2]));
  return {found->log_odds[offset], found->count[offset]};
}

std::vector<const Block*> VoxelMap::sorted_blocks() const {
  std::vector<const Block*> sorted;
  sorted.reserve(blocks_.size());
  for (const Block& block : blocks_) sorted.push_back(&block);
  std::sort(sorted.begin(), sorted.end(),
            [](const Block* a, const Block* b) { return a->key < b->key; });
  return sorted;
}

Vec3 VoxelMap::voxel_centre(const BlockKey& key, int offset) const {
  const auto centre = [this](std::int32_t block, int local) {
    return (static_cast<double>(block) * kBlockEdge + local + 0.5) * resolution_m_;
  };
  return {centre(key.x, offset % kBlockEdge), centre(key.y, offset / kBlockEdge % kBlockEdge),
          centre(key.z, offset / (kBlockEdge * kBlockEdge))};
}

void VoxelMap::clear() {
  blocks_.clear();
  slots_.assign(kFirstSlots, kEmpty);
}

}  // namespace mapperd
