// OctoMap itself reads what we write: every voxel, and nothing else.
#include <octomap/OcTree.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <sstream>

#include "check.hpp"
#include "mapperd/octomap_file.hpp"
#include "mapperd/projective.hpp"
#include "scenes.hpp"

namespace {

using mapperd::VoxelMap;
using Contents = std::map<std::array<std::int64_t, 3>, bool>;

// Leaves of OctoMap's tree, those above the finest level expanded to voxels.
Contents contents_of(const octomap::OcTree& tree) {
  Contents contents;
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    const auto edge = std::int64_t{1} << (tree.getTreeDepth() - leaf.getDepth());
    const octomap::OcTreeKey key = leaf.getIndexKey();
    for (std::int64_t i = 0; i < edge * edge * edge; ++i) {
      contents[{key[0] - 32768 + i % edge, key[1] - 32768 + i / edge % edge,
                key[2] - 32768 + i / edge / edge}] = tree.isNodeOccupied(*leaf);
    }
  }
  return contents;
}

Contents contents_of(const VoxelMap& map, double occupied, double free) {
  Contents contents;
  for (const mapperd::Block* block : map.sorted_blocks()) {
    for (int i = 0; i < mapperd::kBlockVoxels; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const double log_odds = block->log_odds[at];
      if (block->count[at] == 0 || (log_odds >= free && log_odds <= occupied)) continue;
      contents[{block->key.x * 8LL + i % 8, block->key.y * 8LL + i / 8 % 8,
                block->key.z * 8LL + i / 64}] = log_odds > occupied;
    }
  }
  return contents;
}

void check_round_trip(const VoxelMap& map) {
  const double occupied = std::log(0.7 / 0.3);
  std::istringstream file(octomap_bt(map, occupied, 0.0));
  octomap::OcTree tree(1.0);
  CHECK(tree.readBinary(file));
  CHECK(tree.getResolution() == map.resolution_m());
  CHECK(contents_of(tree) == contents_of(map, occupied, 0.0));
  if (map.block_count() == 0) return;
  // Points of the map frame, so that half a voxel of shift would show.
  for (const auto& [voxel, is_occupied] : contents_of(map, occupied, 0.0)) {
    const auto centre = [&](std::size_t i) {
      return (static_cast<double>(voxel[i]) + 0.5) * map.resolution_m();
    };
    const octomap::OcTreeNode* node = tree.search(centre(0), centre(1), centre(2));
    CHECK(node != nullptr && tree.isNodeOccupied(node) == is_occupied);
  }
}

TEST_CASE("OctoMap reads our maps with equal content") {
  for (int scene = 0; scene < 5; ++scene) {
    scenes::Random random(200 + static_cast<std::uint64_t>(scene));
    VoxelMap map(random.uniform(0.05, 0.3), {});
    for (int i = 0; i < 4; ++i) {
      const scenes::Ping ping = scenes::random_ping(random);
      integrate_projective(map, ping.image(), scenes::random_pose(random), {});
    }
    CHECK(map.block_count() > 0);
    check_round_trip(map);
  }
}

TEST_CASE("OctoMap reads an empty map and pruned blocks") {
  VoxelMap map(0.1, {});
  check_round_trip(map);
  for (int x = -2; x < 2; ++x) {
    mapperd::Block& block = map.get_or_create({x, 0, -1});
    block.log_odds.fill(x < 0 ? 3.0F : -3.0F);
    block.count.fill(1);
  }
  check_round_trip(map);
}

}  // namespace
