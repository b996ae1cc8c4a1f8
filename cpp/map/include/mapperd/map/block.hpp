// A block of 16 x 16 x 16 voxels, in as little memory as its content needs.
//
// Space that is wholly free, or seen alike throughout, is one state for all voxels. A block that a
// surface crosses holds every voxel; free pings over the whole of it are only counted, as long as
// every voxel's free step is independent of its log-odds, and applied when somebody opens it, or
// when they are so many that all voxels must have come to be alike.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "mapperd/map/iwlo.hpp"

namespace mapperd::map {

inline constexpr int kBlockEdge = 16;
inline constexpr int kBlockShift = 4;
inline constexpr int kBlockVoxels = kBlockEdge * kBlockEdge * kBlockEdge;

// Block coordinates stay within +-kMaxBlock, so that voxel indices and sums of them fit easily.
inline constexpr std::int32_t kMaxBlock = 1 << 30;

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

// Index of a voxel inside its block, x fastest.
inline int voxel_offset(int x, int y, int z) { return x + kBlockEdge * (y + kBlockEdge * z); }

// A voxel with count 0 was never observed.
struct Voxel {
  std::int32_t units = 0;  // log-odds in kLogOddsUnit
  std::uint16_t count = 0;
};

// Every voxel of a block, structure of arrays.
struct DenseVoxels {
  std::array<std::int32_t, kBlockVoxels> units;
  std::array<std::uint16_t, kBlockVoxels> count;
};

// Some voxels of a block: a bit a voxel, 16 in a row along x, the rows as voxel_offset() has them.
inline constexpr int kBlockRows = kBlockEdge * kBlockEdge;
using VoxelRows = std::array<std::uint16_t, kBlockRows>;

class Block {
 public:
  explicit Block(const BlockKey& block_key) : key(block_key) {}

  BlockKey key;
  std::uint64_t revision = 0;  // of the map, when this block last changed

  // One free observation of every voxel; false when nothing changed, all being settled. O(1)
  // unless a voxel is believed occupied.
  bool add_free_everywhere(const IwloRule& rule);

  // One free observation of some of an open block's voxels; false when nothing changed.
  bool add_free(const IwloRule& rule, const VoxelRows& rows);

  // Every voxel is at the lower clamp and its count settled: free observations change nothing.
  bool is_settled_free(const IwloRule& rule) const {
    return dense_ == nullptr && uniform_.units == rule.min_units() &&
           uniform_.count == rule.settled_count();
  }

  // The voxels themselves, to be changed; call close() after it.
  DenseVoxels& open(const IwloRule& rule);
  void close(const IwloRule& rule);

  // Makes all voxels alike, whatever they were; not between open() and close().
  void fill(const Voxel& voxel);

  Voxel voxel(const IwloRule& rule, int offset) const;
  void copy_voxels(const IwloRule& rule, DenseVoxels& out) const;  // all of them
  int known_count() const;  // voxels that were ever observed; of a block that is not open
  bool is_dense() const { return dense_ != nullptr; }
  std::size_t voxel_bytes() const;  // allocated for voxels, beside the block itself
  std::size_t memory_bytes() const { return sizeof(Block) + voxel_bytes(); }

 private:
  bool add_free_steps(const IwloRule& rule, const IwloRule::FreeSteps& steps,
                      const VoxelRows& rows);

  Voxel uniform_;  // all voxels, unless dense_
  bool all_unscaled_ = true;
  std::uint16_t dense_known_ = 0;  // observed voxels of dense_, without pending_
  std::uint32_t pending_ = 0;      // free steps not yet applied to dense_
  std::unique_ptr<DenseVoxels> dense_;
};

}  // namespace mapperd::map
