/// \file
/// \brief The map: a hash of blocks of voxels, each with log-odds and an observation count.
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

/// Within +-kMaxBlock on every axis.
bool in_reach(const BlockKey& key);

/// A voxel of the map: it spans index to index + 1 times the resolution along each axis.
struct VoxelIndex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int64_t z = 0;

  friend bool operator==(const VoxelIndex& a, const VoxelIndex& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }
};

/// Blocks from the first to the last along each axis, both with.
struct BlockBox {
  BlockKey first{-kMaxBlock, -kMaxBlock, -kMaxBlock};
  BlockKey last{kMaxBlock, kMaxBlock, kMaxBlock};

  bool holds(const BlockKey& key) const { return meets(key, key); }

  /// Whether it shares a block with the box from `low` to `high`.
  bool meets(const BlockKey& low, const BlockKey& high) const {
    return low.x <= last.x && low.y <= last.y && low.z <= last.z && high.x >= first.x &&
           high.y >= first.y && high.z >= first.z;
  }
};

/// Every voxel of a block, x fastest.
using BlockStates = std::array<Voxel, kBlockVoxels>;

/// State of one voxel; a count of 0 means never observed.
struct VoxelState {
  float log_odds = 0.0F;
  std::uint16_t count = 0;
};

/// Threads: the members take no lock. The functions of the other headers (integrators, updates,
/// queries, snapshots, files) each take the one that they need, once, and see or make one whole
/// state of the map; a caller that uses the members of a map shared with other threads must hold a
/// ReadLock or a WriteLock (below), and must call none of those functions under it. The resolution
/// and the rule never change, but for the rule's intensity threshold, and need no lock; nor does
/// what they alone decide (index_of, centre_of).
class VoxelMap {
 public:
  /// \throws std::invalid_argument for a resolution that is not finite and positive, or bad rules.
  VoxelMap(double resolution_m, const IwloParams& iwlo);

  double resolution_m() const { return resolution_m_; }
  const IwloRule& rule() const { return rule_; }
  void set_intensity_threshold(double intensity) { rule_.set_intensity_threshold(intensity); }

  std::size_t block_count() const { return blocks_.size(); }
  std::size_t memory_bytes() const;  ///< all allocations, within 5 % of malloc's figure
  std::size_t known_count() const;   ///< voxels that were ever observed
  std::size_t held_count() const {   ///< voxels held one by one
    return pool_.in_use() * kCellVoxels;
  }

  /// Increases with every change of the map. A block's revision is that of its last change.
  std::uint64_t revision() const { return revision_; }
  std::uint64_t next_revision() { return ++revision_; }

  /// The revision at which all blocks were removed or replaced; 0 if they never were.
  std::uint64_t replaced_at() const { return replaced_at_; }

  /// Raises the revision to at least this, to continue from another map's revision.
  void raise_revision(std::uint64_t least) { revision_ = std::max(revision_, least); }

  /// Divides the map into tiles; no tile is resident yet. Blocks can be created only in
  /// resident tiles. Writers call residency().fetch() first: the integrators do; other writes fail
  /// where a tile is missing. What is not resident reads as unknown.
  /// \throws std::logic_error for a
  /// map that has content or is cut already.
  void cut_into_tiles(Residency residency);
  Residency& residency() { return residency_; }
  const Residency& residency() const { return residency_; }
  void drop_tiles(const std::vector<BlockKey>& tiles);

  /// Limits pings to the blocks within the box. These change as without a limit: maps of adjacent
  /// boxes together equal the unlimited map.
  /// \throws std::invalid_argument for a box without blocks.
  void limit_to(const BlockBox& box);
  const BlockBox& limit() const { return limit_; }

  /// \throws std::out_of_range when the key lies beyond +-kMaxBlock, and std::logic_error when its
  /// tile is not resident.
  Block& get_or_create(const BlockKey& key);
  const Block* find(const BlockKey& key) const;
  Block* find(const BlockKey& key);
  /// Adds a block whose cells lie in this map's pool and whose key is new.
  /// \throws std::logic_error when its tile is not resident.
  Block& insert(Block block);
  CellPool& pool() { return pool_; }
  const CellPool& pool() const { return pool_; }

  /// Returns the voxel at a point of the map frame, m; unknown for points beyond the map's reach.
  VoxelState at(const Vec3& point_m) const;
  VoxelState at(const VoxelIndex& voxel) const;

  /// Sets the state of a voxel; a count of 0 resets it to unknown.
  /// \throws std::out_of_range beyond the map's reach.
  void set(const VoxelIndex& voxel, const VoxelState& state);

  /// Sets many voxels of one block, within the clamps; voxels with a count of 0 do not change.
  void set_block(const BlockKey& key, const BlockStates& states);
  /// The same, without a new revision: the caller sets the block's revision.
  Block& write_block(const BlockKey& key, const BlockStates& states);

  Voxel voxel(const Block& block, int offset) const { return block.voxel(rule_, pool_, offset); }

  /// Finds the voxel that holds a point of the map frame, m; returns false beyond the map's reach
  /// and for points that are not finite.
  bool index_of(const Vec3& point_m, VoxelIndex& voxel) const;
  Vec3 centre_of(const VoxelIndex& voxel) const;

  /// Visits all observed voxels, in the map's canonical order.
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

  /// Blocks ordered by key: the map's canonical order.
  std::vector<const Block*> sorted_blocks() const;

  static VoxelIndex index_of(const BlockKey& key, int offset);
  VoxelState state_of(const Voxel& voxel) const {
    return {static_cast<float>(rule_.log_odds(voxel.units)), voxel.count};
  }

  /// This and the next throw std::logic_error for a map in tiles: it is not all here.
  void clear();

  /// Exchanges the content with that of a map of the same resolution, clamps and settled count that
  /// no other thread uses. All blocks count as changed.
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
  std::vector<std::uint32_t> slots_;  ///< open addressing, a power of two, at most half full
};

/// Shared lock: no thread writes to the map during its lifetime.
class [[nodiscard]] ReadLock {
 public:
  explicit ReadLock(const VoxelMap& map) : lock_(map.mutex()) {}

 private:
  std::shared_lock<MapMutex> lock_;
};

/// Exclusive lock: no other thread reads or writes the map during its lifetime.
class [[nodiscard]] WriteLock {
 public:
  explicit WriteLock(VoxelMap& map) : lock_(map.mutex()) {}

 private:
  std::unique_lock<MapMutex> lock_;
};

/// Resets all voxels to unknown.
void clear(VoxelMap& map);

/// Sets the intensity from which a sample is a return; voxels do not change.
/// \throws std::invalid_argument if it is not finite.
void set_intensity_threshold(VoxelMap& map, double intensity);

}  // namespace mapperd::map
