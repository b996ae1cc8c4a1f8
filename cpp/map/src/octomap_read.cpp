#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <sstream>
#include <string>

#include "mapperd/map/octomap_file.hpp"
#include "mapperd/map/octomap_tree.hpp"

namespace mapperd::map {
namespace {

// OctoMap writes the resolution with six digits; half a unit of the sixth is 5e-6 at most.
constexpr double kResolutionTolerance = 5.001e-6;

constexpr std::uint32_t kBlock = 16;  // edge of the cubes that memory is taken in

// Counts the memory that the leaves will take, in voxels.
class Budget {
 public:
  explicit Budget(std::uint64_t max_voxels) : max_voxels_(max_voxels) {}

  void spend(std::size_t at, const OctomapCube& leaf) {
    const std::uint64_t edge = std::max(leaf.edge(), kBlock);
    // The leaves of one block follow each other.
    const std::uint64_t block = leaf.x / kBlock | std::uint64_t{leaf.y / kBlock} << 16U |
                                std::uint64_t{leaf.z / kBlock} << 32U;
    if (block == last_block_) return;
    last_block_ = block;
    voxels_ += edge * edge * edge;  // cubes are disjoint: 2^48 in all
    if (voxels_ > max_voxels_) {
      refuse_octomap(at, "the tree takes more than the " + std::to_string(max_voxels_) +
                             " voxels of max_voxels");
    }
  }

 private:
  std::uint64_t max_voxels_;
  std::uint64_t voxels_ = 0;
  std::uint64_t last_block_ = std::numeric_limits<std::uint64_t>::max();
};

void check_resolution(const OctomapHeader& header, double resolution_m) {
  if (std::abs(header.resolution_m - resolution_m) <= kResolutionTolerance * resolution_m) return;
  std::ostringstream what;
  what << "the tree's voxels are " << header.resolution_m << " m, the map's " << resolution_m
       << " m";
  refuse_octomap(0, what.str());
}

// Gathers the leaves of one block's cube, so that the map can take them at once.
class Filler {
 public:
  explicit Filler(VoxelMap& map) : map_(map) {}

  void add(const OctomapCube& leaf, std::int16_t units) {
    // Once for a leaf within a block, else for each block of the leaf.
    for (std::uint32_t z = 0; z < leaf.edge(); z += kBlock) {
      for (std::uint32_t y = 0; y < leaf.edge(); y += kBlock) {
        for (std::uint32_t x = 0; x < leaf.edge(); x += kBlock) {
          enter({corner_of(leaf.x + x), corner_of(leaf.y + y), corner_of(leaf.z + z)});
          set(leaf, units);
        }
      }
    }
  }

  // Hands the gathered voxels to the map; the last thing to do.
  void flush() {
    const auto block = [](std::uint32_t key) {
      return static_cast<std::int32_t>((std::int64_t{key} - kOctomapKeyOrigin) >> kBlockShift);
    };
    map_.set_block({block(block_.x), block(block_.y), block(block_.z)}, states_);
    states_.fill({});
  }

 private:
  static std::uint32_t corner_of(std::uint32_t key) { return key & ~(kBlock - 1); }

  void enter(const OctomapCube& block) {
    if (block.x == block_.x && block.y == block_.y && block.z == block_.z) return;
    flush();
    block_ = block;
  }

  // The leaf's voxels in this block: all of them, or the part from its corner on.
  void set(const OctomapCube& leaf, std::int16_t units) {
    const std::uint32_t edge = std::min(leaf.edge(), kBlock);
    for (std::uint32_t i = 0; i < edge * edge * edge; ++i) {
      const std::uint32_t x = leaf.x % kBlock + i % edge;
      const std::uint32_t y = leaf.y % kBlock + i / edge % edge;
      const std::uint32_t z = leaf.z % kBlock + i / (edge * edge);
      states_[x + kBlock * (y + kBlock * z)] = {units, 1};
    }
  }

  VoxelMap& map_;
  OctomapCube block_;
  std::array<Voxel, kBlock * kBlock * kBlock> states_{};
};

}  // namespace

void load_octomap(std::string_view file, VoxelMap& map, std::uint64_t max_voxels) {
  const OctomapHeader header = parse_octomap_header(file);
  check_resolution(header, map.resolution_m());
  // Everything is read once before the map is touched.
  Budget budget(max_voxels);
  for_each_octomap_leaf(file, header, [&](std::size_t at, const OctomapCube& leaf, double) {
    budget.spend(at, leaf);
  });
  const WriteLock lock(map);
  map.clear();
  try {
    Filler filler(map);
    for_each_octomap_leaf(file, header, [&](std::size_t, const OctomapCube& leaf, double log_odds) {
      filler.add(leaf, map.rule().units(log_odds));
    });
    filler.flush();
  } catch (...) {
    map.clear();
    throw;
  }
}

}  // namespace mapperd::map
