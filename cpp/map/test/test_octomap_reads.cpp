// OctoMap as the judge: it reads what we write, and we read what it writes, with equal content.
#include <octomap/OcTree.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <sstream>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/octomap_file.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;
using Contents = std::map<std::array<std::int64_t, 3>, float>;

const double kOccupied = std::log(0.7 / 0.3);
constexpr double kFree = 0.0;

// Leaves of OctoMap's tree, those above the finest level expanded to voxels.
Contents contents_of(const octomap::OcTree& tree) {
  Contents contents;
  for (auto leaf = tree.begin_leafs(); leaf != tree.end_leafs(); ++leaf) {
    const auto edge = std::int64_t{1} << (tree.getTreeDepth() - leaf.getDepth());
    const octomap::OcTreeKey key = leaf.getIndexKey();
    for (std::int64_t i = 0; i < edge * edge * edge; ++i) {
      contents[{key[0] - 32768 + i % edge, key[1] - 32768 + i / edge % edge,
                key[2] - 32768 + i / edge / edge}] = leaf->getLogOdds();
    }
  }
  return contents;
}

Contents contents_of(const VoxelMap& map) {
  Contents contents;
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    contents[{voxel.x, voxel.y, voxel.z}] = state.log_odds;
  });
  return contents;
}

// What is left of a map in a .bt: OctoMap's clamps for the classes.
Contents classes_of(const VoxelMap& map, const octomap::OcTree& tree) {
  Contents contents;
  for (const auto& [voxel, log_odds] : contents_of(map)) {
    if (log_odds >= kFree && log_odds <= kOccupied) continue;
    contents[voxel] =
        log_odds > kOccupied ? tree.getClampingThresMaxLog() : tree.getClampingThresMinLog();
  }
  return contents;
}

// Equal voxels, with equal log-odds.
void check_equal(const Contents& actual, const Contents& expected, double rounded = 0.0) {
  CHECK(actual.size() == expected.size());
  auto a = actual.begin();
  for (auto e = expected.begin(); e != expected.end() && a != actual.end(); ++e, ++a) {
    CHECK(a->first == e->first);
    CHECK(a->second == near(e->second, rounded + 1e-7 + 1e-7 * std::abs(e->second)));
  }
}

// Points of the map frame, so that half a voxel of shift would show.
void check_points(const octomap::OcTree& tree, const VoxelMap& map) {
  for (const auto& [voxel, log_odds] : contents_of(tree)) {
    const mapperd::Vec3 centre = map.centre_of({voxel[0], voxel[1], voxel[2]});
    const octomap::OcTreeNode* node = tree.search(centre.x, centre.y, centre.z);
    CHECK((node != nullptr && node->getLogOdds() == log_odds));
  }
}

std::unique_ptr<octomap::OcTree> read_ot(const std::string& file) {
  std::istringstream stream(file);
  std::unique_ptr<octomap::AbstractOcTree> tree(octomap::AbstractOcTree::read(stream));
  CHECK(stream.good());
  CHECK(stream.peek() == std::istringstream::traits_type::eof());
  auto* as_octree = dynamic_cast<octomap::OcTree*>(tree.get());
  if (as_octree != nullptr) static_cast<void>(tree.release());
  return std::unique_ptr<octomap::OcTree>(as_octree);
}

void check_octomap_reads(const VoxelMap& map) {
  std::istringstream file(octomap_bt(map, kOccupied, kFree));
  octomap::OcTree bt(1.0);
  CHECK(bt.readBinary(file));
  CHECK(bt.getResolution() == map.resolution_m());
  CHECK(contents_of(bt) == classes_of(map, bt));
  check_points(bt, map);
  const Contents contents = contents_of(map);
  if (contents.empty()) return;  // OctoMap cannot read its own empty .ot: see octomap_file.hpp
  const std::string written = octomap_ot(map);
  const auto ot = read_ot(written);
  CHECK(ot != nullptr);
  if (ot == nullptr) return;
  CHECK(written.find("\nsize " + std::to_string(ot->size()) + "\n") != std::string::npos);
  CHECK(ot->getResolution() == map.resolution_m());
  CHECK(contents_of(*ot) == contents);
  check_points(*ot, map);
  // Nothing is left to prune, and inner nodes are what OctoMap makes of them.
  const std::size_t nodes = ot->size();
  std::ostringstream before;
  std::ostringstream after;
  ot->write(before);
  ot->prune();
  CHECK(ot->size() == nodes);
  ot->updateInnerOccupancy();
  ot->write(after);
  CHECK(before.str() == after.str());
}

TEST_CASE("OctoMap reads our maps with equal content") {
  for (int scene = 0; scene < 5; ++scene) {
    scenes::Random random(200 + static_cast<std::uint64_t>(scene));
    VoxelMap map(random.uniform(0.05, 0.3), {});
    for (int i = 0; i < 4; ++i) {
      const scenes::Ping ping = scenes::random_ping(random);
      integrate_evidence_grid(map, ping.image(), scenes::random_pose(random), {});
    }
    CHECK(!contents_of(map).empty());
    check_octomap_reads(map);
  }
}

TEST_CASE("OctoMap reads an empty map and pruned blocks") {
  VoxelMap map(0.1, {});
  check_octomap_reads(map);
  for (int i = 0; i < 32 * 8 * 8; ++i) {
    const int x = i % 32 - 16;
    map.set({x, i / 32 % 8, i / 256 - 8}, {x < 0 ? 3.0F : -3.0F, 1});
  }
  check_octomap_reads(map);
}

// Boxes of one value each beside single voxels, near the origin and at the ends of the keys.
void fill(octomap::OcTree& tree, scenes::Random& random) {
  const auto set = [&](int x, int y, int z, double log_odds) {
    const auto key = [](int i) { return static_cast<octomap::key_type>(i); };
    tree.setNodeValue(octomap::OcTreeKey(key(x), key(y), key(z)), static_cast<float>(log_odds),
                      true);
  };
  for (int box = 0; box < 5; ++box) {
    const int at = 32768 + 8 * random.integer(-9, 9);
    const double log_odds = random.uniform(-2, 3.5);
    for (int i = 0; i < 16 * 16 * 16; ++i) {
      set(at + i % 16, at + i / 16 % 16, 32768 + i / 256, log_odds);
    }
  }
  for (int i = 0; i < 1000; ++i) {
    set(32768 + random.integer(-40, 40), 32768 + random.integer(-40, 40),
        32768 + random.integer(-40, 40), random.uniform(-2, 3.5));
  }
  set(0, 0, 0, -1.0);
  set(65535, 65535, 65535, 1.0);
  tree.updateInnerOccupancy();
}

void check_we_read(octomap::OcTree& tree) {
  VoxelMap map(tree.getResolution(), {});
  std::ostringstream ot;
  CHECK(tree.write(ot));
  load_octomap(ot.str(), map);
  check_equal(contents_of(map), contents_of(tree), 0.5 * map.rule().unit());

  std::ostringstream bt;
  CHECK(tree.writeBinaryConst(bt));
  load_octomap(bt.str(), map);
  tree.toMaxLikelihood();
  check_equal(contents_of(map), contents_of(tree), 0.5 * map.rule().unit());
}

TEST_CASE("we read OctoMap's trees with equal content, pruned or not") {
  for (std::uint64_t seed = 300; seed < 303; ++seed) {
    // More digits than OctoMap writes.
    for (const double resolution_m : {0.05, 0.123456789}) {
      for (const bool pruned : {false, true}) {
        scenes::Random random(seed);
        octomap::OcTree tree(resolution_m);
        fill(tree, random);
        const std::size_t unpruned = tree.size();
        if (pruned) tree.prune();
        CHECK((tree.size() < unpruned) == pruned);
        check_we_read(tree);
      }
    }
  }
}

TEST_CASE("we read what OctoMap prunes by itself before it writes a .bt") {
  scenes::Random random(400);
  octomap::OcTree tree(0.1);
  fill(tree, random);
  std::ostringstream file;
  CHECK(tree.writeBinary(file));
  VoxelMap map(0.1, {});
  load_octomap(file.str(), map);
  check_equal(contents_of(map), contents_of(tree), 0.5 * map.rule().unit());
}

TEST_CASE("we read OctoMap's empty trees") {
  octomap::OcTree tree(0.1);
  std::ostringstream ot;
  std::ostringstream bt;
  CHECK(tree.write(ot));
  CHECK(tree.writeBinary(bt));
  for (const std::string& file : {ot.str(), bt.str()}) {
    VoxelMap map(0.1, {});
    map.set({1, 1, 1}, {1.0F, 1});
    load_octomap(file, map);
    CHECK(contents_of(map).empty());
  }
}

}  // namespace
