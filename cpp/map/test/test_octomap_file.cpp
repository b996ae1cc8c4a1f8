// The bytes of the .bt and .ot writers; that OctoMap itself reads them is test_octomap_reads.cpp.
#include <stdexcept>
#include <string>

#include "mapperd/map/octomap_file.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;

// Values of these tests are sums of few powers of two: exact in any representation.
void set(VoxelMap& map, const VoxelIndex& voxel, float log_odds) { map.set(voxel, {log_odds, 1}); }

void set_eight(VoxelMap& map, float log_odds) {
  for (int i = 0; i < 8; ++i) set(map, {i & 1, i >> 1 & 1, i >> 2}, log_odds);
}

std::string header(const char* first_line, int nodes) {
  return std::string(first_line) + "\n# Written by mapperd\nid OcTree\nsize " +
         std::to_string(nodes) + "\nres 0.5\ndata\n";
}
std::string bt_header(int nodes) { return header("# Octomap OcTree binary file", nodes); }
std::string ot_header(int nodes) { return header("# Octomap OcTree file", nodes); }

// Inner nodes from the root to `depth`, towards the origin: key 32768 = 2^15 on each axis is child
// 7 of the root, and child 0 from there on.
std::string bt_chain(int depth) {
  std::string chain("\x00\xC0", 2);
  for (int d = 1; d < depth; ++d) chain += std::string("\x03\x00", 2);
  return chain;
}
std::string ot_chain(int depth, const std::string& value) {
  std::string chain = value + "\x80";
  for (int d = 1; d < depth; ++d) chain += value + "\x01";
  return chain;
}

const std::string kTwo("\x00\x00\x00\x40", 4);         // 2.0F, little endian
const std::string kMinusThree("\x00\x00\x40\xC0", 4);  // -3.0F
const std::string kZeroByte(1, '\0');

TEST_CASE("an empty map is a tree of size 0") {
  CHECK(octomap_bt(VoxelMap(0.5, {}), 0.8, 0.0) == bt_header(0));
  CHECK(octomap_ot(VoxelMap(0.5, {})) == ot_header(0));
}

TEST_CASE("one voxel at the origin is a chain of inner nodes") {
  VoxelMap map(0.5, {});
  set(map, {0, 0, 0}, 2.0F);
  CHECK(octomap_bt(map, 0.8, 0.0) == bt_header(17) + bt_chain(15) + std::string("\x02\x00", 2));
  CHECK(octomap_ot(map) == ot_header(17) + ot_chain(16, kTwo) + kTwo + kZeroByte);
}

TEST_CASE("eight equal children become one leaf, and a .bt has no place for the uncertain") {
  VoxelMap map(0.5, {});
  set_eight(map, -3.0F);
  const std::string ot = ot_header(16) + ot_chain(15, kMinusThree) + kMinusThree + kZeroByte;
  CHECK(octomap_ot(map) == ot);
  set(map, {2, 0, 0}, 0.5F);  // neither above 0.8 nor below 0
  CHECK(octomap_bt(map, 0.8, 0.0) == bt_header(16) + bt_chain(14) + std::string("\x01\x00", 2));
  CHECK(octomap_ot(map) != ot);
}

TEST_CASE("inner nodes of a .ot hold the maximum of their children") {
  VoxelMap map(0.5, {});
  set(map, {0, 0, 0}, -3.0F);
  set(map, {1, 1, 0}, 2.0F);
  const std::string last = kTwo + "\x09";
  CHECK(octomap_ot(map) ==
        ot_header(18) + ot_chain(15, kTwo) + last + kMinusThree + kZeroByte + kTwo + kZeroByte);
}

TEST_CASE("a .ot keeps eight children apart that a .bt merges") {
  VoxelMap map(0.5, {});
  set_eight(map, -3.0F);
  set(map, {1, 1, 1}, -2.0F);
  CHECK(octomap_bt(map, 0.8, 0.0) == bt_header(16) + bt_chain(14) + std::string("\x01\x00", 2));
  CHECK(octomap_ot(map).size() == ot_header(24).size() + 24 * 5);
}

TEST_CASE("a block of one state and the same block voxel by voxel are the same file") {
  VoxelMap uniform(0.1, {}), dense(0.1, {});
  for (VoxelMap* map : {&uniform, &dense}) {
    for (int i = 0; i < 120; ++i) {
      for (int x = -2; x < 2; ++x) {
        // One voxel lags behind until all are at the clamp: its cell stays held.
        if (map == &dense && i == 0) map->set({16 * x + 9, 0, 0}, {0.001F, 0 + 1});
        maps::see_free(*map, {x, 0, 0});
      }
    }
    map->set({5, 5, 40}, {2.0F, 1});
  }
  CHECK((uniform.find({0, 0, 0})->held() == 0 && dense.find({0, 0, 0})->held() != 0));
  CHECK(octomap_bt(uniform, 0.8, -0.8) == octomap_bt(dense, 0.8, -0.8));
  CHECK(octomap_ot(uniform) == octomap_ot(dense));
}

TEST_CASE("zero and minus zero give the same .ot") {
  VoxelMap plus(0.5, {});
  VoxelMap minus(0.5, {});
  set_eight(plus, 0.0F);
  set_eight(minus, -0.0F);
  CHECK(octomap_ot(plus) == octomap_ot(minus));
}

TEST_CASE("a voxel beyond OctoMap's keys is refused, the last one inside is not") {
  VoxelMap inside(0.5, {});
  set(inside, {32767, -32768, 0}, 2.0F);
  CHECK(octomap_bt(inside, 0.8, 0.0).size() > bt_header(17).size());
  CHECK(octomap_ot(inside).size() == ot_header(17).size() + 17 * 5);
  for (const VoxelIndex& far : {VoxelIndex{32768, 0, 0}, VoxelIndex{0, -32769, 0}}) {
    VoxelMap outside(0.5, {});
    set(outside, far, 2.0F);
    CHECK_THROWS_AS(octomap_bt(outside, 0.8, 0.0), std::out_of_range);
    CHECK_THROWS_AS(octomap_ot(outside), std::out_of_range);
  }
}

TEST_CASE("an uncertain voxel beyond OctoMap's keys does not stop a .bt") {
  VoxelMap map(0.5, {});
  set(map, {32768, 0, 0}, 0.5F);
  CHECK(octomap_bt(map, 0.8, 0.0) == bt_header(0));
}

}  // namespace
