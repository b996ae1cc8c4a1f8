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
