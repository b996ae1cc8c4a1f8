/// \file
/// \brief A block of 16 x 16 x 16 voxels in 64 cells of 4 x 4 x 4, in as little memory as its
/// content needs.
///
/// A cell whose voxels are alike is one state. Any other cell is held voxel by voxel, in a slot of
/// the map's pool. Free observations of whole cells are only counted (`pending`), as long as every
/// voxel's free step is independent of its log-odds; they are applied when the cell is opened, or
/// when they are so many that all voxels must have come to be alike.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "mapperd/map/cell_pool.hpp"
#include "mapperd/map/iwlo.hpp"

namespace mapperd::map {

inline constexpr int kBlockEdge = 16;
inline constexpr int kBlockShift = 4;
inline constexpr int kBlockVoxels = kBlockEdge * kBlockEdge * kBlockEdge;
inline constexpr int kBlockCells = kBlockVoxels / kCellVoxels;

/// Block coordinates stay within +-kMaxBlock, so that voxel indices and sums of them fit easily.
inline constexpr std::int32_t kMaxBlock = 1 << 30;

/// Position of a block of 16^3 voxels, in blocks from the map's origin.
struct BlockKey {
  std::int32_t x = 0;
  std::int32_t y = 0;
  std::int32_t z = 0;

  friend bool operator==(const BlockKey& a, const BlockKey& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }
  friend bool operator<(const BlockKey& a, const BlockKey& b) {
    if (a.x != b.x) return a.x < b.x;
    return a.y != b.y ? a.y < b.y : a.z < b.z;
  }
};

/// Index of a voxel inside its block, x fastest.
inline int voxel_offset(int x, int y, int z) { return x + kBlockEdge * (y + kBlockEdge * z); }

/// Cell of a voxel of a block, and its index in the cell, both x fastest.
struct CellPlace {
  int cell;
  int voxel;
};
inline CellPlace cell_place(int offset) {
  const int x = offset & 15, y = offset >> 4 & 15, z = offset >> 8;
  return {(x >> 2) + 4 * ((y >> 2) + 4 * (z >> 2)), (x & 3) + 4 * ((y & 3) + 4 * (z & 3))};
}
inline int offset_of_cell(int cell) {
  return voxel_offset(4 * (cell & 3), 4 * (cell >> 2 & 3), 4 * (cell >> 4));
}
inline int offset_in_cell(int voxel) { return voxel_offset(voxel & 3, voxel >> 2 & 3, voxel >> 4); }

/// A voxel with count 0 was never observed.
struct Voxel {
  std::int16_t units = 0;  ///< log-odds in the rule's unit
  std::uint16_t count = 0;

  friend bool operator==(const Voxel& a, const Voxel& b) {
    return a.units == b.units && a.count == b.count;
  }
};

/// Every voxel of a block, x fastest.
struct DenseVoxels {
  std::array<std::int16_t, kBlockVoxels> units;
  std::array<std::uint16_t, kBlockVoxels> count;
};

/// Every voxel of a cell, x fastest.
struct DenseCell {
  std::array<std::int16_t, kCellVoxels> units;
  std::array<std::uint16_t, kCellVoxels> count;
};

/// A set of a block's cells, a bit each.
using CellSet = std::uint64_t;
inline constexpr CellSet kAllCells = ~CellSet{0};
constexpr CellSet cell_bit(int cell) { return CellSet{1} << cell; }

/// 16^3 voxels as 4^3 cells: uniform cells hold one value, mixed ones their voxels.
class Block {
 public:
  /// Creates a block of unknown voxels.
  Block(const BlockKey& block_key, const IwloRule& rule)
      : key(block_key), above_(rule.unscaled_up_to() < 0 ? kAllCells : 0) {}

  BlockKey key;
  std::uint64_t revision = 0;  ///< of the map, when this block last changed

  /// Adds one free observation to every voxel of some cells; returns false if nothing changed, all
  /// being at the floor. O(1) per cell unless a voxel is believed occupied.
  bool add_free(const IwloRule& rule, CellPool::Cache& pool, CellSet cells);

  /// Returns a cell's voxels for writing; call close() afterwards.
  CellVoxels open(const IwloRule& rule, CellPool::Cache& pool, int cell);
  void close(const IwloRule& rule, CellPool::Cache& pool, int cell);

  /// Prefetches a cell's voxels into the cache, if it is held.
  void prefetch(const CellPool::Cache& pool, int cell) const {
    if (!is_held(cell)) return;
    const auto* const slot =
        reinterpret_cast<const char*>(pool[state_[static_cast<std::size_t>(cell)]].units());
    __builtin_prefetch(slot);
    __builtin_prefetch(slot + 64);
    __builtin_prefetch(slot + 128);
  }

  /// Makes all voxels of a cell alike, whatever they were; not between open() and close().
  void fill(const IwloRule& rule, CellPool::Cache& pool, int cell, const Voxel& voxel);

  /// Forgets all voxels.
  void clear(const IwloRule& rule, CellPool::Cache& pool);
  /// Moves the slots to another pool.
  void move_cells(const CellPool& from, CellPool::Cache& to);

  Voxel voxel(const IwloRule& rule, const CellPool& pool, int offset) const;
  void copy_voxels(const IwloRule& rule, const CellPool& pool, DenseVoxels& out) const;
  /// Copies the voxels of a cell that is held, x fastest.
  void copy_held(const IwloRule& rule, const CellPool& pool, int cell, DenseCell& out) const;

  /// The one state of a cell's voxels, if it is held as one.
  bool is_held(int cell) const { return (held_ & cell_bit(cell)) != 0; }
  Voxel alike(const IwloRule& rule, int cell) const;
  /// The one state of all voxels, if they are alike.
  bool all_alike(const IwloRule& rule, Voxel& voxel) const;
  /// Cells in which free observations change nothing: every voxel is at the lower clamp with a
  /// saturated count.
  CellSet at_floor() const { return at_floor_; }

  CellSet held() const { return held_; }
  int known_count(const CellPool& pool) const;  ///< voxels that were ever observed

 private:
  void apply_pending(const IwloRule& rule, CellPool::Cache& pool, int cell);
  void settle(const IwloRule& rule, CellPool::Cache& pool);
  void set_alike(const IwloRule& rule, int cell, const Voxel& voxel);

  std::uint8_t max_pending_ = 0;  ///< no cell has more
  CellSet held_ = 0;
  CellSet above_ = 0;  ///< cells with a voxel whose free step depends on its log-odds
  CellSet at_floor_ = 0;
  std::array<std::uint8_t, kBlockCells> pending_{};  ///< free steps not yet applied
  std::array<std::uint32_t, kBlockCells> state_{};   ///< a slot, or the state of all voxels
};

}  // namespace mapperd::map
