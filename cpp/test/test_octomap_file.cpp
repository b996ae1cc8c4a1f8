// The .bt writer's bytes; that OctoMap itself reads them is a test in Python.
#include <stdexcept>
#include <string>

#include "check.hpp"
#include "mapperd/octomap_file.hpp"

namespace {

using mapperd::VoxelMap;

void set(VoxelMap& map, int x, int y, int z, float log_odds) {
  mapperd::Block& block = map.get_or_create({x >> 3, y >> 3, z >> 3});
  const auto at = static_cast<std::size_t>(mapperd::voxel_offset(x & 7, y & 7, z & 7));
  block.log_odds[at] = log_odds;
  block.count[at] = 1;
}

std::string header(int nodes) {
  return "# Octomap OcTree binary file\n# Written by mapperd\nid OcTree\nsize " +
         std::to_string(nodes) + "\nres 0.5\ndata\n";
}

TEST_CASE("an empty map is a tree of size 0") {
  CHECK(octomap_bt(VoxelMap(0.5, {}), 0.8, 0.0) == header(0));
}

TEST_CASE("one occupied voxel at the origin is a chain of inner nodes") {
  VoxelMap map(0.5, {});
  set(map, 0, 0, 0, 2.0F);
  // Key 32768 = 2^15: child 7 of the root, then child 0 to the leaf.
  std::string expected = header(17) + std::string("\x00\xC0", 2);
  for (int depth = 1; depth < 15; ++depth) expected += std::string("\x03\x00", 2);
  expected += std::string("\x02\x00", 2);
  CHECK(octomap_bt(map, 0.8, 0.0) == expected);
}

TEST_CASE("eight equal children become one leaf, and the uncertain is unknown") {
  VoxelMap map(0.5, {});
  for (int i = 0; i < 8; ++i) set(map, i & 1, i >> 1 & 1, i >> 2, -2.0F);
  set(map, 2, 0, 0, 0.4F);  // neither above 0.8 nor below 0
  std::string expected = header(16) + std::string("\x00\xC0", 2);
  for (int depth = 1; depth < 14; ++depth) expected += std::string("\x03\x00", 2);
  expected += std::string("\x01\x00", 2);
  CHECK(octomap_bt(map, 0.8, 0.0) == expected);
}

TEST_CASE("a voxel beyond OctoMap's keys is refused, the last one inside is not") {
  VoxelMap inside(0.5, {});
  set(inside, 32767, -32768, 0, 2.0F);
  CHECK(octomap_bt(inside, 0.8, 0.0).size() > header(17).size());
  VoxelMap outside(0.5, {});
  set(outside, 32768, 0, 0, 2.0F);
  CHECK_THROWS(octomap_bt(outside, 0.8, 0.0), std::out_of_range);
}

}  // namespace
