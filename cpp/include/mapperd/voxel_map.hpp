// The map: a hash of blocks of 8x8x8 voxels, each with log-odds and an observation count.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <vector>

#include "mapperd/iwlo.hpp"
#include "mapperd/vec.hpp"

namespace mapperd {

inline constexpr int kBlockEdge = 8;
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

// A voxel of the map: it spans index to index + 1 times the resolution along each axis.
struct VoxelIndex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int64_t z = 0;

  friend bool operator==(const VoxelIndex& a, const VoxelIndex& b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
  }
};

// Index of a voxel inside its block, x fastest.
inline int voxel_offset(int x, int y, int z) { return x + kBlockEdge * (y + kBlockEdge * z); }

// Structure of arrays. A voxel with count 0 was never observed.
struct Block {
  explicit Block(const BlockKey& block_key) : key(block_key) {}

  BlockKey key;
  std::array<float, kBlockVoxels> log_odds{};
  std::array<std::uint16_t, kBlockVoxels> count{};
};

struct VoxelState {
  float log_odds = 0.0F;
  std::uint16_t count = 0;
};

class VoxelMap {
 public:
  // Throws std::invalid_argument for a resolution that is not finite and positive, or bad rules.
  VoxelMap(double resolution_m, const IwloParams& iwlo);

  double resolution_m() const { return resolution_m_; }
  const IwloRule& rule() const { return rule_; }

  std::size_t block_count() const { return blocks_.size(); }
  std::size_t memory_bytes() const;  // blocks and hash table

  // Throws std::out_of_range when the key lies beyond +-kMaxBlock.
  Block& get_or_create(const BlockKey& key);
  const Block* find(const BlockKey& key) const;

  // The voxel at a point of the map frame; unknown for points beyond the map's reach.
  VoxelState at(const Vec3& point_m) const;
  VoxelState at(const VoxelIndex& voxel) const;

  // Sets a voxel as if it had been observed so; a count of 0 forgets it.
  // Throws std::out_of_range beyond the map's reach.
  void set(const VoxelIndex& voxel, const VoxelState& state);

  // The voxel that holds a point; false beyond the map's reach and for points that are not finite.
  bool index_of(const Vec3& point_m, VoxelIndex& voxel) const;
  Vec3 centre_of(const VoxelIndex& voxel) const;

  // Visits all observed voxels, in the map's canonical order.
  template <typename Visit>  // void(const VoxelIndex&, const VoxelState&)
  void for_each_known(const Visit& visit) const {
    for (const Block* block : sorted_blocks()) {
      for (int i = 0; i < kBlockVoxels; ++i) {
        const auto at = static_cast<std::size_t>(i);
        if (block->count[at] == 0) continue;
        const VoxelIndex voxel{
            block->key.x * std::int64_t{kBlockEdge} + i % kBlockEdge,
            block->key.y * std::int64_t{kBlockEdge} + i / kBlockEdge % kBlockEdge,
            block->key.z * std::int64_t{kBlockEdge} + i / (kBlockEdge * kBlockEdge)};
        visit(voxel, VoxelState{block->log_odds[at], block->count[at]});
      }
    }
  }

  // Blocks ordered by key: the map's canonical order.
  std::vector<const Block*> sorted_blocks() const;

  // Centre of a voxel in the map frame.
  Vec3 voxel_centre(const BlockKey& key, int offset) const;

  void clear();

 private:
  static constexpr std::uint32_t kEmpty = 0xFFFFFFFFU;

  std::size_t slot_of(const BlockKey& key) const;
  void grow();

  double resolution_m_;
  IwloRule rule_;
  std::deque<Block> blocks_;          // references stay valid while blocks are added
  std::vector<std::uint32_t> slots_;  // open addressing, a power of two, at most half full
};

}  // namespace mapperd
