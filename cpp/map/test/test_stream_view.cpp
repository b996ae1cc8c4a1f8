// The map stream's blocks, against a look at every voxel.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "mapperd/map/brick.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/key_index.hpp"
#include "mapperd/map/stream_view.hpp"
#include "maps.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::BlockKey;
using mapperd::map::kStreamCells;
using mapperd::map::StreamDetail;
using mapperd::map::StreamView;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;

constexpr mapperd::map::Thresholds kThresholds{0.8, -0.8};

StreamView view_of(int level, StreamDetail detail, double step = 0.25) {
  return {level, detail, step, kThresholds};
}

struct StreamCells {
  std::vector<std::int8_t> cells = std::vector<std::int8_t>(kStreamCells, -128);
  std::vector<std::uint8_t> bits = std::vector<std::uint8_t>(kStreamCells, 0);
};
using Content = std::map<BlockKey, StreamCells>;

std::int8_t cell_value(const VoxelState& state, const StreamView& view) {
  if (view.detail == StreamDetail::kClasses) {
    const auto occupancy = kThresholds.of(state);
    if (occupancy == mapperd::map::Occupancy::kOccupied) return 1;
    return occupancy == mapperd::map::Occupancy::kFree ? -1 : 0;
  }
  // The nearest step of those that the thresholds sort as they do the log-odds.
  const double exact = static_cast<double>(state.log_odds) / view.log_odds_step;
  const auto same = [&](int steps) {
    const double log_odds = steps * view.log_odds_step;
    const auto occupancy = kThresholds.of(state);
    return (log_odds > kThresholds.occupied_log_odds) ==
               (occupancy == mapperd::map::Occupancy::kOccupied) &&
           (log_odds < kThresholds.free_log_odds) == (occupancy == mapperd::map::Occupancy::kFree);
  };
  const int nearest = static_cast<int>(std::clamp(std::nearbyint(exact), -127.0, 127.0));
  for (int away = 0; away < 255; ++away) {
    for (const int steps : {nearest - away, nearest + away}) {
      if (std::abs(steps) <= 127 && same(steps)) return static_cast<std::int8_t>(steps);
    }
  }
  return static_cast<std::int8_t>(nearest);
}

// Voxel by voxel: every value grows with the log-odds, so that the highest is that of the highest.
Content expected(const VoxelMap& map, const StreamView& view) {
  Content content;
  const int shift = view.level + 3;
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    const auto block = [&](std::int64_t i) { return static_cast<std::int32_t>(i >> shift); };
    const auto local = [&](std::int64_t i) { return (i >> view.level) & 7; };
    StreamCells& result = content[{block(voxel.x), block(voxel.y), block(voxel.z)}];
    const auto cell =
        static_cast<std::size_t>(local(voxel.x) + 8 * (local(voxel.y) + 8 * local(voxel.z)));
    result.cells[cell] = std::max(result.cells[cell], cell_value(state, view));
    const auto bits = static_cast<std::uint8_t>(std::floor(std::log2(state.count)) + 1);
    result.bits[cell] = std::max(result.bits[cell], bits);
  });
  return content;
}

std::vector<BlockKey> keys_of(const Content& content) {
  std::vector<BlockKey> keys;
  for (const auto& entry : content) keys.push_back(entry.first);
  return keys;
}

bool agree(const VoxelMap& map, const StreamView& view) {
  const Content content = expected(map, view);
  const auto result = stream_blocks(map, view, keys_of(content));
  std::size_t i = 0;
  for (const auto& entry : content) {
    const auto at = static_cast<std::ptrdiff_t>(kStreamCells * i);
    if (result.resident[i] != 1) return false;
    if (!std::equal(entry.second.cells.begin(), entry.second.cells.end(),
                    result.cells.begin() + at)) {
      return false;
    }
    if (!std::equal(entry.second.bits.begin(), entry.second.bits.end(),
                    result.count_bits.begin() + at)) {
      return false;
    }
    ++i;
  }
  return i > 0 && result.revision == map.revision();
}

TEST_CASE("cells and counts are those of all voxels, at every level and detail") {
  const VoxelMap map = maps::random_map(5, kSanitized ? 1500 : 6000, 70);
  for (int level = 0; level <= 3; ++level) {
    for (const auto detail :
         {StreamDetail::kClasses, StreamDetail::kLogOdds, StreamDetail::kCounts}) {
      for (const double step : {0.25, 0.1, 3.7, 0.001})
        CHECK(agree(map, view_of(level, detail, step)));
    }
  }
}

TEST_CASE("blocks all alike, and free pings that are only counted, are encoded as they read") {
  VoxelMap map(0.1, {});
  scenes::Random random(4);
  for (int i = 0; i < 12; ++i) {
    mapperd::Transform pose = scenes::random_pose(random);
    pose.translation = {};
    integrate_evidence_grid(map, scenes::random_ping(random).image(), pose, {});
  }
  maps::change_block(map, {9, 9, 9}, [](int, std::int16_t& units, std::uint16_t& count) {
    units = -2048;
    count = 60;
  });
  map.get_or_create({9, 9, 10});  // as a brick that was forgotten leaves it
  for (int level = 0; level <= 3; ++level) CHECK(agree(map, view_of(level, StreamDetail::kCounts)));

  VoxelMap pending(0.1, {});
  pending.set({1, 2, 3}, {-1.0F, 4});
  CHECK((maps::see_free(pending, {}) && pending.find({})->held() != 0));
  for (int level = 0; level <= 3; ++level)
    CHECK(agree(pending, view_of(level, StreamDetail::kCounts)));
}

TEST_CASE("halves of a step go to the even one") {
  VoxelMap map(0.1, {});
  const std::vector<std::pair<float, int>> cases{{0.5F, 0},   {1.5F, 2},   {2.5F, 2}, {-0.5F, 0},
                                                 {-1.5F, -2}, {-2.5F, -2}, {3.49F, 3}};
  for (std::size_t i = 0; i < cases.size(); ++i) {
    map.set({static_cast<std::int64_t>(i), 0, 0}, {cases[i].first, 1});
  }
  const auto result = stream_blocks(map, view_of(0, StreamDetail::kLogOdds, 1.0), {{0, 0, 0}});
  for (std::size_t i = 0; i < cases.size(); ++i) CHECK(result.cells[i] == cases[i].second);
  CHECK(result.cells[7] == -128);
}

TEST_CASE("a digest changes with the encoded cells only") {
  VoxelMap map(0.1, {});
  const std::vector<BlockKey> key{{0, 0, 0}};
  const auto digest = [&](StreamDetail detail) {
    return stream_digests(map, view_of(0, detail), key).digests[0];
  };
  CHECK(digest(StreamDetail::kCounts) == 0);
  map.set({3, 0, 0}, {2.0F, 4});
  const auto classes = digest(StreamDetail::kClasses);
  const auto log_odds = digest(StreamDetail::kLogOdds);
  const auto counts = digest(StreamDetail::kCounts);
  CHECK((classes != 0 && log_odds != 0 && counts != 0));
  map.set({3, 0, 0}, {2.1F, 5});  // the same step, as many bits
  CHECK(digest(StreamDetail::kCounts) == counts);
  map.set({3, 0, 0}, {2.1F, 9});
  CHECK((digest(StreamDetail::kCounts) != counts && digest(StreamDetail::kLogOdds) == log_odds));
  map.set({3, 0, 0}, {2.6F, 9});
  CHECK((digest(StreamDetail::kLogOdds) != log_odds && digest(StreamDetail::kClasses) == classes));
  map.set({3, 0, 0}, {-2.6F, 9});
  CHECK(digest(StreamDetail::kClasses) != classes);
  CHECK(stream_digests(map, view_of(0, StreamDetail::kCounts), key).revisions[0] == map.revision());

  std::set<std::uint64_t> seen;
  for (int x = 0; x < 512; ++x) {  // one voxel, everywhere in turn
    VoxelMap one(0.1, {});
    one.set({x & 7, x >> 3 & 7, x >> 6}, {2.0F, 1});
    seen.insert(stream_digests(one, view_of(0, StreamDetail::kLogOdds), key).digests[0]);
  }
  CHECK(seen.size() == 512);
}

TEST_CASE("blocks that changed after a revision, and when all were replaced") {
  VoxelMap map(0.1, {});
  map.set({0, 0, 0}, {1.0F, 1});
  map.set({100, 0, 0}, {1.0F, 1});
  const auto first = changed_blocks(map, 0, {});
  CHECK((first.keys.size() == 2 && first.revision == 2 && first.replaced_at == 0));
  map.set({-1, 0, 0}, {1.0F, 1});
  const auto next = changed_blocks(map, first.revision, {});
  CHECK((next.keys.size() == 1 && next.keys[0] == (BlockKey{-1, 0, 0}) && next.revisions[0] == 3));
  CHECK(changed_blocks(map, next.revision, {}).keys.empty());
  clear(map);
  CHECK(changed_blocks(map, next.revision, {}).replaced_at == 4);
}

TEST_CASE("what is not in memory is unknown and not resident") {
  VoxelMap map(0.1, {});
  map.cut_into_tiles({mapperd::map::kBrickEdge, [](const std::vector<BlockKey>&) {}});
  put_bricks(map, {}, {{0, 0, 0}});
  map.set({1, 1, 1}, {1.0F, 1});
  CHECK(
      (changed_blocks(map, 0, {{0, 0, 0}, {1, 0, 0}}).resident == std::vector<std::uint8_t>{1, 0}));
  for (int level = 0; level <= 3; ++level) {
    const StreamView view = view_of(level, StreamDetail::kLogOdds);
    const int across = 64 >> (3 + level);  // stream blocks in a brick
    const std::vector<BlockKey> keys{{0, 0, 0}, {across - 1, 0, 0}, {across, 0, 0}, {-1, 0, 0}};
    const auto result = stream_digests(map, view, keys);
    CHECK((result.resident == std::vector<std::uint8_t>{1, 1, 0, 0}));
    CHECK((result.digests[0] != 0 && result.digests[2] == 0));
    CHECK(stream_blocks(map, view, keys).resident == result.resident);
  }
}

TEST_CASE("keys at the map's end are unknown, and bad views refused") {
  VoxelMap map(0.1, {});
  map.set({0, 0, 0}, {3.0F, 5});  // which multiples of 2^32 are in 32 bits
  const std::int32_t far = 2147483647;
  for (int level = 0; level <= 3; ++level) {
    const auto result = stream_digests(map, view_of(level, StreamDetail::kLogOdds),
                                       {{far, far, far}, {-far - 1, 0, 0}});
    CHECK((result.digests[0] == 0 && result.digests[1] == 0));
  }
  CHECK_THROWS_AS(stream_digests(map, view_of(4, StreamDetail::kLogOdds), {}),
                  std::invalid_argument);
  CHECK_THROWS_AS(stream_blocks(map, view_of(-1, StreamDetail::kLogOdds), {}),
                  std::invalid_argument);
  CHECK_THROWS_AS(stream_blocks(map, view_of(0, StreamDetail::kLogOdds, 0.0), {}),
                  std::invalid_argument);
}

TEST_CASE("keys keep their numbers") {
  mapperd::map::KeyIndex index;
  scenes::Random random(8);
  std::map<BlockKey, std::uint32_t> expected_numbers;
  for (int i = 0; i < 5000; ++i) {
    const auto any = [&] { return static_cast<std::int32_t>(random.integer(-9, 9)); };
    const BlockKey key{any(), any(), any() * 1000000};
    CHECK((index.find(key) == mapperd::map::KeyIndex::kNone) == (expected_numbers.count(key) == 0));
    const auto next = static_cast<std::uint32_t>(expected_numbers.size());
    const std::uint32_t number = expected_numbers.try_emplace(key, next).first->second;
    CHECK((index.find_or_add(key) == number && index[number] == key));
  }
  CHECK((index.size() == expected_numbers.size() && index.size() > 2000));
}

}  // namespace
