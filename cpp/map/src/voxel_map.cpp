#include "mapperd/map/voxel_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "mapperd/common/memory_use.hpp"

namespace mapperd::map {
namespace {

constexpr std::size_t kFirstSlots = 64;

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

bool block_of(const VoxelIndex& voxel, BlockKey& key) {
  const auto coordinate = [](std::int64_t i, std::int32_t& block) {
    const std::int64_t shifted = i >> kBlockShift;
    block = static_cast<std::int32_t>(shifted);
    return shifted >= -kMaxBlock && shifted <= kMaxBlock;
  };
  return coordinate(voxel.x, key.x) && coordinate(voxel.y, key.y) && coordinate(voxel.z, key.z);
}

int offset_of(const VoxelIndex& voxel) {
  const auto local = [](std::int64_t i) { return static_cast<int>(i & (kBlockEdge - 1)); };
  return voxel_offset(local(voxel.x), local(voxel.y), local(voxel.z));
}

}  // namespace

bool in_reach(const BlockKey& key) {
  const auto ok = [](std::int32_t v) { return v >= -kMaxBlock && v <= kMaxBlock; };
  return ok(key.x) && ok(key.y) && ok(key.z);
}

VoxelMap::VoxelMap(double resolution_m, const IwloParams& iwlo)
    : resolution_m_(resolution_m),
      rule_(iwlo),
      pool_(rule_.count_bytes()),
      slots_(kFirstSlots, kEmpty) {
  if (!(std::isfinite(resolution_m) && resolution_m >= 1e-4 && resolution_m <= 1e4)) {
    throw std::invalid_argument("resolution_m must lie between 0.0001 and 10000 m");
  }
}

std::size_t VoxelMap::memory_bytes() const {
  return sizeof(VoxelMap) + rule_.memory_bytes() + allocated_by(slots_) + blocks_.memory_bytes() +
         pool_.memory_bytes() + residency_.memory_bytes();
}

std::size_t VoxelMap::known_count() const {
  std::size_t count = 0;
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    count += static_cast<std::size_t>(blocks_[i].known_count(pool_));
  }
  return count;
}

std::size_t VoxelMap::slot_of(const BlockKey& key) const {
  const std::size_t mask = slots_.size() - 1;
  std::size_t slot = hash_of(key) & mask;
  while (slots_[slot] != kEmpty && !(blocks_[slots_[slot]].key == key)) slot = (slot + 1) & mask;
  return slot;
}

void VoxelMap::index_blocks(std::size_t slots) {
  std::vector<std::uint32_t> indexed(slots, kEmpty);
  slots_.swap(indexed);
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    slots_[slot_of(blocks_[i].key)] = static_cast<std::uint32_t>(i);
  }
}

void VoxelMap::check_whole() const {
  if (residency_.is_partial()) throw std::logic_error("the map is in tiles: ask its store");
}

void VoxelMap::cut_into_tiles(Residency residency) {
  check_whole();
  if (blocks_.size() != 0) throw std::logic_error("a map with content cannot be cut into tiles");
  residency_ = std::move(residency);
}

void VoxelMap::drop_tiles(const std::vector<BlockKey>& tiles) {
  for (const BlockKey& tile : tiles) residency_.remove(tile);
  {
    CellPool::Cache pool(pool_);
    for (std::size_t i = 0; i < blocks_.size(); ++i) {
      if (!residency_.holds(blocks_[i].key)) blocks_[i].clear(rule_, pool);
    }
  }
  blocks_.keep_if([this](const Block& block) { return residency_.holds(block.key); });
  if (pool_.is_sparse()) compact();
  std::size_t slots = kFirstSlots;
  while (slots < 2 * blocks_.size()) slots *= 2;
  index_blocks(slots);
}

// Moves all cells to a pool that holds no more than them.
void VoxelMap::compact() {
  CellPool pool(rule_.count_bytes());
  {
    CellPool::Cache to(pool);
    for (std::size_t i = 0; i < blocks_.size(); ++i) blocks_[i].move_cells(pool_, to);
  }
  pool_ = std::move(pool);
}

void VoxelMap::limit_to(const BlockBox& box) {
  if (!box.meets(box.first, box.first)) throw std::invalid_argument("the box holds no block");
  limit_ = box;
}

Block& VoxelMap::get_or_create(const BlockKey& key) {
  if (!in_reach(key)) throw std::out_of_range("the block lies beyond the map's reach");
  Block* const found = find(key);
  return found != nullptr ? *found : insert(Block(key, rule_));
}

Block& VoxelMap::insert(Block block) {
  if (!residency_.holds(block.key)) {
    throw std::logic_error("a block in a tile that is not in memory");
  }
  if (2 * (blocks_.size() + 1) > slots_.size()) index_blocks(2 * slots_.size());
  // Memory may run out up to here, and the map is as before.
  Block& added = blocks_.add(block);
  slots_[slot_of(block.key)] = static_cast<std::uint32_t>(blocks_.size() - 1);
  return added;
}

const Block* VoxelMap::find(const BlockKey& key) const {
  const std::size_t slot = slot_of(key);
  return slots_[slot] == kEmpty ? nullptr : &blocks_[slots_[slot]];
}

Block* VoxelMap::find(const BlockKey& key) {
  const std::size_t slot = slot_of(key);
  return slots_[slot] == kEmpty ? nullptr : &blocks_[slots_[slot]];
}

bool VoxelMap::index_of(const Vec3& point_m, VoxelIndex& voxel) const {
  const auto index = [this](double position, std::int64_t& i) {
    const double floored = std::floor(position / resolution_m_);
    // The negation also refuses what is not finite.
    if (!(std::abs(floored) < static_cast<double>(kMaxBlock) * kBlockEdge)) return false;
    i = static_cast<std::int64_t>(floored);
    return true;
  };
  return index(point_m.x, voxel.x) && index(point_m.y, voxel.y) && index(point_m.z, voxel.z);
}

Vec3 VoxelMap::centre_of(const VoxelIndex& voxel) const {
  const auto centre = [this](std::int64_t i) {
    return (static_cast<double>(i) + 0.5) * resolution_m_;
  };
  return {centre(voxel.x), centre(voxel.y), centre(voxel.z)};
}

VoxelState VoxelMap::at(const Vec3& point_m) const {
  VoxelIndex voxel;
  return index_of(point_m, voxel) ? at(voxel) : VoxelState{};
}

VoxelState VoxelMap::at(const VoxelIndex& voxel) const {
  BlockKey key;
  if (!block_of(voxel, key)) return {};
  const Block* found = find(key);
  if (found == nullptr) return {};
  return state_of(this->voxel(*found, offset_of(voxel)));
}

Voxel VoxelMap::voxel_of(const VoxelState& state) const {
  if (state.count == 0) return {};
  return {rule_.units(state.log_odds), std::min(state.count, rule_.settled_count())};
}

void VoxelMap::set(const VoxelIndex& voxel, const VoxelState& state) {
  BlockKey key;
  if (!block_of(voxel, key)) throw std::out_of_range("the voxel lies beyond the map's reach");
  Block& block = get_or_create(key);
  const CellPlace at = cell_place(offset_of(voxel));
  const Voxel updated = voxel_of(state);
  CellPool::Cache pool(pool_);
  const CellVoxels voxels = block.open(rule_, pool, at.cell);
  voxels.units()[at.voxel] = updated.units;
  voxels.set_count(at.voxel, updated.count);
  block.close(rule_, pool, at.cell);
  block.revision = next_revision();
}

void VoxelMap::set_block(const BlockKey& key, const BlockStates& states) {
  const auto observed = [](const Voxel& state) { return state.count != 0; };
  if (std::none_of(states.begin(), states.end(), observed)) return;
  write_block(key, states).revision = next_revision();
}

Block& VoxelMap::write_block(const BlockKey& key, const BlockStates& states) {
  Block& block = get_or_create(key);
  CellPool::Cache pool(pool_);
  for (int cell = 0; cell < kBlockCells; ++cell) {
    const CellVoxels voxels = block.open(rule_, pool, cell);
    for (int v = 0; v < kCellVoxels; ++v) {
      const Voxel& state =
          states[static_cast<std::size_t>(offset_of_cell(cell) + offset_in_cell(v))];
      if (state.count == 0) continue;
      voxels.units()[v] = state.units;
      voxels.set_count(v, state.count);
    }
    block.close(rule_, pool, cell);
  }
  return block;
}

VoxelIndex VoxelMap::index_of(const BlockKey& key, int offset) {
  const auto index = [](std::int32_t block, int local) {
    return static_cast<std::int64_t>(block) * kBlockEdge + local;
  };
  return {index(key.x, offset % kBlockEdge), index(key.y, offset / kBlockEdge % kBlockEdge),
          index(key.z, offset / (kBlockEdge * kBlockEdge))};
}

std::vector<const Block*> VoxelMap::sorted_blocks() const {
  std::vector<const Block*> sorted;
  sorted.reserve(blocks_.size());
  for (std::size_t i = 0; i < blocks_.size(); ++i) sorted.push_back(&blocks_[i]);
  std::sort(sorted.begin(), sorted.end(),
            [](const Block* a, const Block* b) { return a->key < b->key; });
  return sorted;
}

void VoxelMap::clear() {
  check_whole();
  std::vector<std::uint32_t> empty(kFirstSlots, kEmpty);
  blocks_ = BlockStore();
  pool_ = CellPool(rule_.count_bytes());
  slots_.swap(empty);
  replaced_at_ = ++revision_;
}

void VoxelMap::take_blocks(VoxelMap& other) {
  check_whole();
  std::swap(blocks_, other.blocks_);
  pool_.swap(other.pool_);
  slots_.swap(other.slots_);
  replaced_at_ = ++revision_;
  for (std::size_t i = 0; i < blocks_.size(); ++i) blocks_[i].revision = revision_;
}

void clear(VoxelMap& map) {
  const WriteLock lock(map);
  map.clear();
}

void set_intensity_threshold(VoxelMap& map, double intensity) {
  const WriteLock lock(map);
  map.set_intensity_threshold(intensity);
}

}  // namespace mapperd::map
