#include "mapperd/octomap_file.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <vector>

namespace mapperd {
namespace {

constexpr int kDepth = 16;
constexpr std::int64_t kKeyOrigin = 32768;

// The two bits of a child in its parent's record.
enum Child : unsigned { kUnknown = 0, kFree = 1, kOccupied = 2, kInner = 3 };

struct Leaf {
  std::uint64_t path;  // three bits a level, from the root's child down
  Child child;
};

// Spreads the 16 bits of v so that each is followed by two zero bits.
std::uint64_t spread(std::uint64_t v) {
  v = (v | v << 32U) & 0x00FF00000000FFFFULL;
  v = (v | v << 16U) & 0x00FF0000FF0000FFULL;
  v = (v | v << 8U) & 0xF00F00F00F00F00FULL;
  v = (v | v << 4U) & 0x30C30C30C30C30C3ULL;
  return (v | v << 2U) & 0x9249249249249249ULL;
}

std::uint64_t key_of(std::int64_t voxel, double resolution_m) {
  const std::int64_t key = voxel + kKeyOrigin;
  if (key < 0 || key >= 2 * kKeyOrigin) {
    std::ostringstream message;
    message << "a voxel at " << static_cast<double>(voxel) * resolution_m
            << " m lies outside the reach of OctoMap's 16-bit keys, +-"
            << static_cast<double>(kKeyOrigin) * resolution_m << " m at this voxel size";
    throw std::out_of_range(message.str());
  }
  return static_cast<std::uint64_t>(key);
}

std::vector<Leaf> sorted_leaves(const VoxelMap& map, double occupied, double free) {
  std::vector<Leaf> leaves;
  for (const Block* block : map.sorted_blocks()) {
    for (int i = 0; i < kBlockVoxels; ++i) {
      const auto at = static_cast<std::size_t>(i);
      if (block->count[at] == 0) continue;
      const double log_odds = block->log_odds[at];
      if (log_odds <= occupied && log_odds >= free) continue;
      const auto voxel = [](std::int32_t b, int local) {
        return static_cast<std::int64_t>(b) * kBlockEdge + local;
      };
      const double s = map.resolution_m();
      const auto x = key_of(voxel(block->key.x, i % kBlockEdge), s);
      const auto y = key_of(voxel(block->key.y, i / kBlockEdge % kBlockEdge), s);
      const auto z = key_of(voxel(block->key.z, i / (kBlockEdge * kBlockEdge)), s);
      leaves.push_back(
          {spread(x) | spread(y) << 1U | spread(z) << 2U, log_odds > occupied ? kOccupied : kFree});
    }
  }
  std::sort(leaves.begin(), leaves.end(),
            [](const Leaf& a, const Leaf& b) { return a.path < b.path; });
  return leaves;
}

class TreeWriter {
 public:
  explicit TreeWriter(const std::vector<Leaf>& leaves) : leaves_(leaves) {}

  // Writes the node over leaves [begin, end) at `depth`, or nothing when it prunes to one leaf.
  Child write(std::size_t begin, std::size_t end, int depth) {
    if (depth == kDepth) {
      ++nodes_;
      return leaves_[begin].child;
    }
    const std::size_t record = data_.size();
    const std::size_t nodes_before = nodes_++;
    data_.append(2, '\0');
    unsigned bits = 0;
    for (unsigned child = 0; child < 8; ++child) {
      const std::size_t child_end = end_of(begin, end, depth, child);
      if (child_end == begin) continue;
      bits |= write(begin, child_end, depth + 1) << (2 * child);
      begin = child_end;
    }
    // Never the root: it would take a map of 65536^3 voxels.
    if (bits == 0x5555U || bits == 0xAAAAU) {
      data_.resize(record);
      nodes_ = nodes_before + 1;
      return bits == 0x5555U ? kFree : kOccupied;
    }
    data_[record] = static_cast<char>(bits & 0xFFU);
    data_[record + 1] = static_cast<char>(bits >> 8U);
    return kInner;
  }

  const std::string& data() const { return data_; }
  std::size_t nodes() const { return nodes_; }

 private:
  std::size_t end_of(std::size_t begin, std::size_t end, int depth, unsigned child) const {
    const int shift = 3 * (kDepth - 1 - depth);
    const auto first = leaves_.begin() + static_cast<std::ptrdiff_t>(begin);
    const auto last = leaves_.begin() + static_cast<std::ptrdiff_t>(end);
    const auto found = std::partition_point(
        first, last, [&](const Leaf& leaf) { return ((leaf.path >> shift) & 7U) <= child; });
    return static_cast<std::size_t>(found - leaves_.begin());
  }

  const std::vector<Leaf>& leaves_;
  std::string data_;
  std::size_t nodes_ = 0;
};

}  // namespace

std::string octomap_bt(const VoxelMap& map, double occupied_log_odds, double free_log_odds) {
  if (!(free_log_odds <= occupied_log_odds)) {
    throw std::invalid_argument("free_log_odds must not exceed occupied_log_odds");
  }
  const std::vector<Leaf> leaves = sorted_leaves(map, occupied_log_odds, free_log_odds);
  TreeWriter writer(leaves);
  if (!leaves.empty()) writer.write(0, leaves.size(), 0);
  std::ostringstream file;
  file.imbue(std::locale::classic());
  file.precision(17);
  file << "# Octomap OcTree binary file\n# Written by mapperd\nid OcTree\nsize " << writer.nodes()
       << "\nres " << map.resolution_m() << "\ndata\n"
       << writer.data();
  return file.str();
}

}  // namespace mapperd
