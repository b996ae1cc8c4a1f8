#include <limits>
#include <map>
#include <stdexcept>

#include "check.hpp"
#include "mapperd/voxel_map.hpp"
#include "scenes.hpp"

namespace {

using mapperd::BlockKey;
using mapperd::VoxelMap;

TEST_CASE("blocks are found again among thousands, near and far") {
  VoxelMap map(0.05, {});
  scenes::Random random(3);
  std::map<std::array<int, 3>, float> expected;
  for (int i = 0; i < 20000; ++i) {
    const int spread = i % 2 == 0 ? 20 : mapperd::kMaxBlock;
    const std::array<int, 3> at{random.integer(-spread, spread), random.integer(-spread, spread),
                                random.integer(-spread, spread)};
    const auto value = static_cast<float>(i);
    map.get_or_create({at[0], at[1], at[2]}).log_odds[5] = value;
    expected[at] = value;
  }
  CHECK(map.block_count() == expected.size());
  for (const auto& [at, value] : expected) {
    const mapperd::Block* block = map.find({at[0], at[1], at[2]});
    CHECK(block != nullptr && block->log_odds[5] == value);
  }
  CHECK(map.find({12345, 1, 1}) == nullptr);
  CHECK(map.memory_bytes() > expected.size() * sizeof(mapperd::Block));
  map.clear();
  CHECK(map.block_count() == 0 && map.find({0, 0, 0}) == nullptr);
}

TEST_CASE("a voxel's centre leads back to the voxel") {
  VoxelMap map(0.05, {});
  scenes::Random random(4);
  for (int i = 0; i < 1000; ++i) {
    const BlockKey key{random.integer(-100000, 100000), random.integer(-9, 9), -1};
    const int offset = random.integer(0, mapperd::kBlockVoxels - 1);
    mapperd::Block& block = map.get_or_create(key);
    block.log_odds[static_cast<std::size_t>(offset)] = static_cast<float>(i + 1);
    CHECK(map.at(map.voxel_centre(key, offset)).log_odds == static_cast<float>(i + 1));
  }
}

TEST_CASE("points and blocks beyond the reach are unknown or refused") {
  VoxelMap map(0.05, {});
  CHECK(map.at(mapperd::Vec3{1e30, 0, 0}).count == 0);
  CHECK(map.at(mapperd::Vec3{std::numeric_limits<double>::quiet_NaN(), 0, 0}).count == 0);
  CHECK_THROWS(map.get_or_create({mapperd::kMaxBlock + 1, 0, 0}), std::out_of_range);
  CHECK(map.block_count() == 0);
}

TEST_CASE("a resolution that is no length is refused") {
  CHECK_THROWS(VoxelMap(0.0, {}), std::invalid_argument);
  CHECK_THROWS(VoxelMap(-0.1, {}), std::invalid_argument);
  CHECK_THROWS(VoxelMap(std::numeric_limits<double>::quiet_NaN(), {}), std::invalid_argument);
  CHECK_THROWS(VoxelMap(std::numeric_limits<double>::infinity(), {}), std::invalid_argument);
}

}  // namespace
