#include "mapperd/map/stream_view.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "mapperd/map/brick.hpp"

namespace mapperd::map {
namespace {

constexpr std::int32_t kNone = std::numeric_limits<std::int32_t>::min();  // no voxel has that

using Highest = std::array<std::int32_t, kStreamCells>;
using Counts = std::array<std::uint16_t, kStreamCells>;
using Cells = std::array<std::int8_t, kStreamCells>;
using Bits = std::array<std::uint8_t, kStreamCells>;

void check(const StreamView& view) {
  check_thresholds(view.thresholds);
  if (view.level < 0 || view.level > kMaxStreamLevel) {
    throw std::invalid_argument("level must be 0 to 3");
  }
  if (!(view.log_odds_step >= 1e-6 && view.log_odds_step <= 1e3)) {
    throw std::invalid_argument("log_odds_step must lie between 0.000001 and 1000");
  }
}

// Rounds to whole numbers, halves to even, as the processor rounds sums: at this size a double has
// no fraction left.
double rounded(double value) {
  constexpr double kShift = 0x1.8p52;
  return (value + kShift) - kShift;
}

std::uint8_t bit_length(std::uint16_t count) {
  std::uint8_t bits = 0;
  for (unsigned rest = count; rest != 0; rest >>= 1U) ++bits;
  return bits;
}

// Extracts stream blocks from a map that is read-locked; quick when those of one block of the map
// follow each other.
class Extractor {
 public:
  Extractor(const VoxelMap& map, const StreamView& view) : map_(map), view_(view) {
    for (std::size_t i = 0; i < bits_of_.size(); ++i) {
      bits_of_[i] = bit_length(static_cast<std::uint16_t>(i));
    }
    for (int steps = -127; steps <= 127; ++steps) {
      const double log_odds = steps * view.log_odds_step;
      if (log_odds < view.thresholds.free_log_odds) highest_free_ = steps;
      if (log_odds > view.thresholds.occupied_log_odds && lowest_occupied_ > steps) {
        lowest_occupied_ = steps;
      }
    }
  }

  const Cells& cells() const { return cells_; }
  const Bits& bits() const { return bits_; }
  std::uint64_t revision() const { return revision_; }

  // False where the tile is not in memory: all is unknown then.
  bool take(const BlockKey& key) {
    clear();
    const std::int64_t across = view_.level == 0 ? 1 : std::int64_t{1} << (view_.level - 1);
    const auto first = [&](std::int32_t i) { return view_.level == 0 ? i >> 1 : i * across; };
    const std::int64_t x = first(key.x), y = first(key.y), z = first(key.z);
    const auto beyond = [&](std::int64_t i) {
      return i < -kMaxBlock || i + across - 1 > kMaxBlock;
    };
    if (beyond(x) || beyond(y) || beyond(z)) return true;
    const auto at = [&](std::int64_t dx, std::int64_t dy, std::int64_t dz) {
      return BlockKey{static_cast<std::int32_t>(x + dx), static_cast<std::int32_t>(y + dy),
                      static_cast<std::int32_t>(z + dz)};
    };
    if (!map_.residency().holds(at(0, 0, 0))) return false;
    if (view_.level == 0) {
      add_part(map_.find(at(0, 0, 0)), key);
    } else {
      for (std::int64_t i = 0; i < across * across * across; ++i) {
        const std::int64_t dx = i % across, dy = i / across % across, dz = i / (across * across);
        add_whole(map_.find(at(dx, dy, dz)), static_cast<int>(dx), static_cast<int>(dy),
                  static_cast<int>(dz));
      }
    }
    if (any_) encode();
    return true;
  }

  // FNV-like over words of eight bytes, each multiplied and turned so that no two places commute.
  std::uint64_t digest() const {
    if (!any_) return 0;
    std::uint64_t hash = 0x9e3779b97f4a7c15ULL;
    mix(hash, cells_.data());
    if (view_.detail == StreamDetail::kCounts) mix(hash, bits_.data());
    hash ^= hash >> 32U;
    hash *= 0xd6e8feb86659fd93ULL;
    hash ^= hash >> 32U;
    return hash == 0 ? 1 : hash;
  }

 private:
  static void mix(std::uint64_t& hash, const void* bytes) {
    for (std::size_t i = 0; i < kStreamCells; i += sizeof hash) {
      std::uint64_t word = 0;
      std::memcpy(&word, static_cast<const char*>(bytes) + i, sizeof word);
      hash = (hash ^ (word * 0xff51afd7ed558ccdULL)) * 0xc4ceb9fe1a85ec53ULL;
      hash = (hash << 27U) | (hash >> 37U);
    }
  }

  void clear() {
    any_ = false;
    revision_ = 0;
    highest_.fill(kNone);
    counts_.fill(0);
    cells_.fill(kStreamUnknown);
    bits_.fill(0);
  }

  const DenseVoxels& voxels_of(const Block& block) {
    if (!held_ || !(held_key_ == block.key)) block.copy_voxels(map_.rule(), map_.pool(), voxels_);
    held_ = true;
    held_key_ = block.key;
    return voxels_;
  }

  // An eighth of a block: each voxel is a cell.
  void add_part(const Block* block, const BlockKey& key) {
    if (block == nullptr) return;
    revision_ = block->revision;
    if (Voxel same; block->all_alike(map_.rule(), same)) return add_uniform(same, 0, kStreamEdge);
    const DenseVoxels& voxels = voxels_of(*block);
    const int begin = voxel_offset(kStreamEdge * (key.x & 1), kStreamEdge * (key.y & 1),
                                   kStreamEdge * (key.z & 1));
    for (int z = 0; z < kStreamEdge; ++z) {
      for (int y = 0; y < kStreamEdge; ++y) {
        const auto from = static_cast<std::size_t>(begin + voxel_offset(0, y, z));
        const auto to = static_cast<std::size_t>(kStreamEdge * (y + kStreamEdge * z));
        for (std::size_t x = 0; x < kStreamEdge; ++x) {
          raise(to + x, voxels.units[from + x], voxels.count[from + x]);
        }
      }
    }
  }

  // A whole block, which is so many cells along an edge.
  void add_whole(const Block* block, int dx, int dy, int dz) {
    if (block == nullptr) return;
    revision_ = std::max(revision_, block->revision);
    const int level = view_.level;
    const int edge = kBlockEdge >> level;
    const int begin = edge * (dx + kStreamEdge * (dy + kStreamEdge * dz));
    if (Voxel same; block->all_alike(map_.rule(), same)) return add_uniform(same, begin, edge);
    const DenseVoxels& voxels = voxels_of(*block);
    std::size_t i = 0;
    for (int z = 0; z < kBlockEdge; ++z) {
      for (int y = 0; y < kBlockEdge; ++y) {
        const int row = begin + kStreamEdge * ((y >> level) + kStreamEdge * (z >> level));
        for (int x = 0; x < kBlockEdge; ++x, ++i) {
          raise(static_cast<std::size_t>(row + (x >> level)), voxels.units[i], voxels.count[i]);
        }
      }
    }
  }

  void add_uniform(const Voxel& voxel, int begin, int edge) {
    for (int z = 0; z < edge; ++z) {
      for (int y = 0; y < edge; ++y) {
        const int row = begin + kStreamEdge * (y + kStreamEdge * z);
        for (int x = 0; x < edge; ++x) {
          raise(static_cast<std::size_t>(row + x), voxel.units, voxel.count);
        }
      }
    }
  }

  void raise(std::size_t cell, std::int32_t units, std::uint16_t count) {
    const std::int32_t known = count != 0 ? units : kNone;
    highest_[cell] = std::max(highest_[cell], known);
    counts_[cell] = std::max(counts_[cell], count);
    any_ |= count != 0;
  }

  void encode() {
    for (std::size_t i = 0; i < kStreamCells; ++i) bits_[i] = count_bits(counts_[i]);
    if (view_.detail == StreamDetail::kClasses) return encode_classes();
    for (std::size_t i = 0; i < kStreamCells; ++i) {
      const double steps = rounded(map_.rule().log_odds(static_cast<std::int16_t>(highest_[i])) /
                                   view_.log_odds_step);
      const int within = static_cast<int>(std::min(std::max(steps, -127.0), 127.0));
      cells_[i] = counts_[i] != 0 ? on_its_side(i, within) : kStreamUnknown;
    }
  }

  // Where no step is on its side, the nearest one stays.
  std::int8_t on_its_side(std::size_t cell, int steps) const {
    int least = -127, most = 127;
    switch (view_.thresholds.of(
        map_.state_of({static_cast<std::int16_t>(highest_[cell]), counts_[cell]}))) {
      case Occupancy::kOccupied:
        least = lowest_occupied_;
        break;
      case Occupancy::kFree:
        most = highest_free_;
        break;
      case Occupancy::kUnknown:
        least = highest_free_ + 1;
        most = lowest_occupied_ - 1;
        break;
    }
    if (least <= most) steps = std::min(std::max(steps, least), most);
    return static_cast<std::int8_t>(steps);
  }

  void encode_classes() {
    for (std::size_t i = 0; i < kStreamCells; ++i) {
      if (counts_[i] == 0) continue;
      const VoxelState state = map_.state_of({static_cast<std::int16_t>(highest_[i]), counts_[i]});
      switch (view_.thresholds.of(state)) {
        case Occupancy::kOccupied:
          cells_[i] = 1;
          break;
        case Occupancy::kFree:
          cells_[i] = -1;
          break;
        case Occupancy::kUnknown:
          cells_[i] = 0;
          break;
      }
    }
  }

  std::uint8_t count_bits(std::uint16_t count) const {
    return count < bits_of_.size() ? bits_of_[count] : bit_length(count);
  }

  const VoxelMap& map_;
  const StreamView& view_;
  int lowest_occupied_ = 128;
  int highest_free_ = -128;
  std::array<std::uint8_t, 256> bits_of_{};
  DenseVoxels voxels_;
  BlockKey held_key_;
  bool held_ = false;
  bool any_ = false;
  std::uint64_t revision_ = 0;
  Highest highest_;
  Counts counts_;
  Cells cells_;
  Bits bits_;
};

}  // namespace

ChangedBlocks changed_blocks(const VoxelMap& map, std::uint64_t revision,
                             const std::vector<BlockKey>& bricks) {
  ChangedBlocks changed;
  changed.resident.reserve(bricks.size());
  const ReadLock lock(map);
  changed.revision = map.revision();
  changed.replaced_at = map.replaced_at();
  if (changed.revision > revision) {
    map.for_each_block([&](const Block& block) {
      if (block.revision <= revision) return;
      changed.keys.push_back(block.key);
      changed.revisions.push_back(block.revision);
    });
  }
  for (const BlockKey& brick : bricks) {
    const BlockKey block{brick.x * kBrickEdge, brick.y * kBrickEdge, brick.z * kBrickEdge};
    changed.resident.push_back(map.residency().holds(block) ? 1 : 0);
  }
  return changed;
}

StreamDigests stream_digests(const VoxelMap& map, const StreamView& view,
                             const std::vector<BlockKey>& keys) {
  check(view);
  StreamDigests result;
  result.digests.reserve(keys.size());
  result.revisions.reserve(keys.size());
  result.resident.reserve(keys.size());
  Extractor extractor(map, view);
  const ReadLock lock(map);
  for (const BlockKey& key : keys) {
    result.resident.push_back(extractor.take(key) ? 1 : 0);
    result.digests.push_back(extractor.digest());
    result.revisions.push_back(extractor.revision());
  }
  return result;
}

StreamBlocks stream_blocks(const VoxelMap& map, const StreamView& view,
                           const std::vector<BlockKey>& keys) {
  check(view);
  StreamBlocks result;
  result.cells.reserve(keys.size() * kStreamCells);
  result.count_bits.reserve(keys.size() * kStreamCells);
  result.resident.reserve(keys.size());
  Extractor extractor(map, view);
  const ReadLock lock(map);
  result.revision = map.revision();
  for (const BlockKey& key : keys) {
    result.resident.push_back(extractor.take(key) ? 1 : 0);
    result.cells.insert(result.cells.end(), extractor.cells().begin(), extractor.cells().end());
    result.count_bits.insert(result.count_bits.end(), extractor.bits().begin(),
                             extractor.bits().end());
  }
  return result;
}

}  // namespace mapperd::map
