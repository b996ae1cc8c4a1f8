#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "mapperd/map/octomap_file.hpp"
#include "mapperd/map/octomap_header.hpp"

namespace mapperd::map {
namespace {

// A block is a node of the tree, because keys begin at a multiple of its edge.
constexpr int kBlockDepth = kOctomapDepth - kBlockShift;
static_assert(kOctomapKeyOrigin % kBlockEdge == 0);

struct Leaf {
  std::uint64_t path;  // three bits a level, from the root's child down
  float value;
  int depth;  // of a voxel, or of a whole block
};

enum class Kind : unsigned char { kUnknown = 0, kLeaf, kInner };

struct Node {
  Kind kind = Kind::kUnknown;
  float value = 0.0F;  // of a leaf; the maximum of the leaves below an inner node
};

using Children = std::array<Node, 8>;

// Spreads the 16 bits of v so that each is followed by two zero bits.
std::uint64_t spread(std::uint64_t v) {
  v = (v | v << 32U) & 0x00FF00000000FFFFULL;
  v = (v | v << 16U) & 0x00FF0000FF0000FFULL;
  v = (v | v << 8U) & 0xF00F00F00F00F00FULL;
  v = (v | v << 4U) & 0x30C30C30C30C30C3ULL;
  return (v | v << 2U) & 0x9249249249249249ULL;
}

std::uint64_t key_of(std::int64_t voxel, double resolution_m) {
  const std::int64_t key = voxel + kOctomapKeyOrigin;
  if (key < 0 || key >= 2 * kOctomapKeyOrigin) {
    std::ostringstream message;
    message << "a voxel at " << static_cast<double>(voxel) * resolution_m
            << " m lies outside the reach of OctoMap's 16-bit keys, +-"
            << static_cast<double>(kOctomapKeyOrigin) * resolution_m << " m at this voxel size";
    throw std::out_of_range(message.str());
  }
  return static_cast<std::uint64_t>(key);
}

// The leaves in the order of the file; a block of one state is one leaf. `value_of` returns what a
// voxel is written as, and whether.
template <typename ValueOf>  // bool(float log_odds, float& value)
std::vector<Leaf> sorted_leaves(const VoxelMap& map, const ValueOf& value_of) {
  std::vector<Leaf> leaves;
  const double s = map.resolution_m();
  const auto add = [&](const VoxelIndex& voxel, const Voxel& state, int depth) {
    float value = 0.0F;
    if (state.count == 0 || !value_of(map.state_of(state).log_odds, value)) return;
    const std::uint64_t x = key_of(voxel.x, s);
    const std::uint64_t y = key_of(voxel.y, s);
    const std::uint64_t z = key_of(voxel.z, s);
    leaves.push_back({spread(x) | spread(y) << 1U | spread(z) << 2U, value, depth});
  };
  const ReadLock lock(map);
  for (const Block* block : map.sorted_blocks()) {
    Voxel voxel;
    if (block->all_alike(map.rule(), voxel)) {
      add(VoxelMap::index_of(block->key, 0), voxel, kBlockDepth);
      continue;
    }
    for (int i = 0; i < kBlockVoxels; ++i) {
      add(VoxelMap::index_of(block->key, i), map.voxel(*block, i), kOctomapDepth);
    }
  }
  std::sort(leaves.begin(), leaves.end(),
            [](const Leaf& a, const Leaf& b) { return a.path < b.path; });
  return leaves;
}

// The value of a .bt's occupied leaves; free ones have its negative.
constexpr float kOccupied = 1.0F;

// Two bits a child, in its parent's record; leaves have none of their own.
struct BtRecord {
  static constexpr std::size_t kBytes = 2;

  static void leaf(std::string& /*data*/, float /*value*/) {}

  static void inner(char* record, const Children& children, float /*value*/) {
    unsigned bits = 0;
    for (unsigned i = 0; i < 8; ++i) bits |= bits_of(children[i]) << (2 * i);
    record[0] = static_cast<char>(bits & 0xFFU);
    record[1] = static_cast<char>(bits >> 8U);
  }

 private:
  static unsigned bits_of(const Node& child) {
    if (child.kind == Kind::kUnknown) return 0;
    if (child.kind == Kind::kInner) return 3;
    return child.value == kOccupied ? 2 : 1;
  }
};

// The log-odds as little-endian float32, then a bit for each child.
struct OtRecord {
  static constexpr std::size_t kBytes = 5;

  static void leaf(std::string& data, float value) {
    data.append(kBytes, '\0');
    put(&data[data.size() - kBytes], value, 0);
  }

  static void inner(char* record, const Children& children, float value) {
    unsigned mask = 0;
    for (unsigned i = 0; i < 8; ++i) mask |= (children[i].kind != Kind::kUnknown ? 1U : 0U) << i;
    put(record, value, mask);
  }

 private:
  static void put(char* record, float value, unsigned mask) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    for (unsigned i = 0; i < 4; ++i) record[i] = static_cast<char>(bits >> (8 * i) & 0xFFU);
    record[4] = static_cast<char>(mask);
  }
};

bool all_equal_leaves(const Children& children) {
  return std::all_of(children.begin(), children.end(), [&](const Node& child) {
    return child.kind == Kind::kLeaf && child.value == children[0].value;
  });
}

float maximum(const Children& children) {
  float value = 0.0F;
  bool any = false;
  for (const Node& child : children) {
    if (child.kind == Kind::kUnknown) continue;
    value = any ? std::max(value, child.value) : child.value;
    any = true;
  }
  return value;
}

template <typename Record>
class TreeWriter {
 public:
  explicit TreeWriter(const std::vector<Leaf>& leaves) : leaves_(leaves) {
    if (!leaves.empty()) write(0, leaves.size(), 0);
  }

  const std::string& data() const { return data_; }
  std::size_t nodes() const { return nodes_; }

 private:
  // Writes the node over leaves [begin, end) at `depth`; as one leaf, if it prunes to that.
  Node write(std::size_t begin, std::size_t end, int depth) {
    if (depth == leaves_[begin].depth) return write_leaf(leaves_[begin].value);
    const std::size_t record = data_.size();
    const std::size_t nodes_before = nodes_++;
    data_.append(Record::kBytes, '\0');
    Children children;
    for (unsigned i = 0; i < 8; ++i) {
      const std::size_t child_end = end_of(begin, end, depth, i);
      if (child_end != begin) children[i] = write(begin, child_end, depth + 1);
      begin = child_end;
    }
    // Never the root: it would take a map of 65536^3 voxels.
    if (all_equal_leaves(children)) {
      data_.resize(record);
      nodes_ = nodes_before;
      return write_leaf(children[0].value);
    }
    const float value = maximum(children);
    Record::inner(&data_[record], children, value);
    return {Kind::kInner, value};
  }

  Node write_leaf(float value) {
    ++nodes_;
    Record::leaf(data_, value);
    return {Kind::kLeaf, value};
  }

  std::size_t end_of(std::size_t begin, std::size_t end, int depth, unsigned child) const {
    const int shift = 3 * (kOctomapDepth - 1 - depth);
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
  const auto leaves = sorted_leaves(map, [&](double log_odds, float& value) {
    value = log_odds > occupied_log_odds ? kOccupied : -kOccupied;
    return log_odds > occupied_log_odds || log_odds < free_log_odds;
  });
  const TreeWriter<BtRecord> tree(leaves);
  return format_octomap_header(true, tree.nodes(), map.resolution_m()) + tree.data();
}

std::string octomap_ot(const VoxelMap& map) {
  const auto leaves = sorted_leaves(map, [](float log_odds, float& value) {
    value = log_odds + 0.0F;  // no -0: equal maps give equal files
    return true;
  });
  const TreeWriter<OtRecord> tree(leaves);
  return format_octomap_header(false, tree.nodes(), map.resolution_m()) + tree.data();
}

}  // namespace mapperd::map
