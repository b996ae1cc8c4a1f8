// The map: a hash of blocks of voxels, each with log-odds and an observation count.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <shared_mutex>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/block.hpp"
#include "mapperd/map/block_store.hpp"
#include "mapperd/map/cell_pool.hpp"
#include "mapperd/map/iwlo.hpp"
#include "mapperd/map/map_mutex.hpp"
#include "mapperd/map/residency.hpp"

namespace mapperd::map {

// Within +-kMaxBlock on every axis.
bool in_reach(const BlockKey& key);

// A voxel of the map: it spans index to index + 1 times the resolution along each axis.
struct VoxelIndex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int64_t z = 0;

  friend bool operator==(const VoxelIndex& a, const VoxelIndex& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }
};

// Blocks from the first to the last along each axis, both with.
struct BlockBox {
  BlockKey first{-kMaxBlock, -kMaxBlock, -kMaxBlock};
  BlockKey last{kMaxBlock, kMaxBlock, kMaxBlock};

  bool holds(const BlockKey& key) const { return meets(key, key); }

  // Whether it shares a block with the box from `low` to `high`.
  bool meets(const BlockKey& low, const BlockKey& high) const {
    return low.x <= last.x && low.y <= last.y && low.z <= last.z && high.x >= first.x &&
           high.y >= first.y && high.z >= first.z;
  }
};

using BlockStates = std::array<Voxel, kBlockVoxels>;

struct VoxelState {
  float log_odds = 0.0F;
  std::uint16_t count = 0;
};

// Threads: the members take no lock. The functions of the other headers (integrators, updates,
// queries, snapshots, files) each take the one that they need, once, and see or make one whole
// state of the map; who calls the members of a map that other threads know holds a ReadLock or a
// WriteLock (below), and calls none of those functions under it. The resolution and the rule never
// change, but for the rule's intensity threshold, and need no lock; nor does what they alone decide
// (index_of, centre_of).
class VoxelMap {
 public:
  // Throws std::invalid_argument for a resolution that is not finite and positive, or bad rules.
  VoxelMap(double resolution_m, const IwloParams& iwlo);

  double resolution_m() const { return resolution_m_; }
  const IwloRule& rule() const { return rule_; }
  void set_intensity_threshold(double intensity) { rule_.set_intensity_threshold(intensity); }

  std::size_t block_count() const { return blocks_.size(); }
  std::size_t memory_bytes() const;  // all that is allocated, within 5 % of what malloc says
  std::size_t known_count() const;   // voxels that were ever observed
  std::size_t held_count() const {   // voxels held one by one
    return pool_.in_use() * kCellVoxels;
  }

  // Counts up with every change of the map; a block's revision tells when it last changed.
  std::uint64_t revision() const { return revision_; }
  std::uint64_t next_revision() { return ++revision_; }

  // The revision at which all blocks went, or others took their place; 0 for a map whose blocks
  // came one by one.
  std::uint64_t replaced_at() const { return replaced_at_; }

  // Makes it at least this; a map that goes on where another ended.
  void raise_revision(std::uint64_t least) { revision_ = std::max(revision_, least); }

  // From now on blocks can be made only in tiles that are resident, and none is yet. Who writes to
  // the map turns to residency().fetch() first: the integrators do, everybody else is refused
  // where a tile is missing. What is not resident reads as unknown.
  // Throws std::logic_error for a map that has content or is cut already.
  void cut_into_tiles(Residency residency);
  Residency& residency() { return residency_; }
  const Residency& residency() const { return residency_; }
  void drop_tiles(const std::vector<BlockKey>& tiles);

  // From now on pings change only blocks within the box, and those as if there were none: maps of
  // boxes side by side are together the map of all.
  // Throws std::invalid_argument for a box without blocks.
  void limit_to(const BlockBox& box);
  const BlockBox& limit() const { return limit_; }

  // Throws std::out_of_range when the key lies beyond +-kMaxBlock, and std::logic_error when its
  // tile is not resident.
  Block& get_or_create(const BlockKey& key);
  const Block* find(const BlockKey& key) const;
  Block* find(const BlockKey& key);
  // Takes a block whose cells lie in this map's pool and whose key it does not know yet.
  // Throws std::logic_error when its tile is not resident.
  Block& insert(Block block);
  CellPool& pool() { return pool_; }
  const CellPool& pool() const { return pool_; }

  // The voxel at a point of the map frame; unknown for points beyond the map's reach.
  VoxelState at(const Vec3& point_m) const;
  VoxelState at(const VoxelIndex& voxel) const;

  // Sets a voxel as if it had been observed so; a count of 0 forgets it.
  // Throws std::out_of_range beyond the map's reach.
  void set(const VoxelIndex& voxel, const VoxelState& state);

  // The same for many voxels of one block at once, inside the clamps; those with a count of 0 stay
  // as they are.
  void set_block(const BlockKey& key, const BlockStates& states);
  // The same, for who says by itself when the block changed.
  Block& write_block(const BlockKey& key, const BlockStates& states);

  Voxel voxel(const Block& block, int offset) const { return block.voxel(rule_, pool_, offset); }

  // The voxel that holds a point; false beyond the map's reach and for points that are not finite.
  bool index_of(const Vec3& point_m, VoxelIndex& voxel) const;
  Vec3 centre_of(const VoxelIndex& voxel) const;

  // Visits all observed voxels, in the map's canonical order.
  template <typename Visit>  // void(const VoxelIndex&, const VoxelState&)
  void for_each_known(const Visit& visit) const {
    for (const Block* block : sorted_blocks()) {
      for (int i = 0; i < kBlockVoxels; ++i) {
        const Voxel known = voxel(*block, i);
        if (known.count != 0) visit(index_of(block->key, i), state_of(known));
      }
    }
  }

  template <typename Visit>  // void(const Block&), in no particular order
  void for_each_block(const Visit& visit) const {
    for (std::size_t i = 0; i < blocks_.size(); ++i) visit(blocks_[i]);
  }

  // Blocks ordered by key: the map's canonical order.
  std::vector<const Block*> sorted_blocks() const;

  static VoxelIndex index_of(const BlockKey& key, int offset);
  VoxelState state_of(const Voxel& voxel) const {
    return {static_cast<float>(rule_.log_odds(voxel.units)), voxel.count};
  }

  // This and the next throw std::logic_error for a map in tiles: it is not all here.
  void clear();

  // Exchanges the content with that of a map of the same resolution, clamps and settled count,
  // which nobody else knows. All blocks count as changed.
  void take_blocks(VoxelMap& other);

  MapMutex& mutex() const { return mutex_; }

 private:
  static constexpr std::uint32_t kEmpty = 0xFFFFFFFFU;

  Voxel voxel_of(const VoxelState& state) const;
  std::size_t slot_of(const BlockKey& key) const;
  void index_blocks(std::size_t slots);
  void check_whole() const;
  void compact();

  mutable MapMutex mutex_;
  double resolution_m_;
  IwloRule rule_;
  std::uint64_t revision_ = 0;
  std::uint64_t replaced_at_ = 0;
  Residency residency_;
  BlockBox limit_;
  CellPool pool_;
  BlockStore blocks_;
  std::vector<std::uint32_t> slots_;  // open addressing, a power of two, at most half full
};

// As long as it lives, nobody writes to the map.
class [[nodiscard]] ReadLock {
 public:
  explicit ReadLock(const VoxelMap& map) : lock_(map.mutex()) {}

 private:
  std::shared_lock<MapMutex> lock_;
};

// As long as it lives, nobody else reads the map or writes to it.
class [[nodiscard]] WriteLock {
 public:
  explicit WriteLock(VoxelMap& map) : lock_(map.mutex()) {}

 private:
  std::unique_lock<MapMutex> lock_;
};

// Forgets all voxels.
void clear(VoxelMap& map);

// What counts as a return from now on; the voxels stay as they are.
// Throws std::invalid_argument if it is not finite.
void set_intensity_threshold(VoxelMap& map, double intensity);

}  // namespace mapperd::map
