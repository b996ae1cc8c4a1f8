// Bricks as bytes, and maps with only some tiles in memory.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "mapperd/map/brick.hpp"
#include "mapperd/map/bytes.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/rays.hpp"
#include "maps.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::BlockKey;
using mapperd::map::BrickView;
using mapperd::map::VoxelMap;

std::vector<BrickView> views(const mapperd::map::ChangedBricks& changed) {
  std::vector<BrickView> all;
  for (const mapperd::map::Brick& brick : changed.bricks) all.push_back({brick.key, brick.bytes});
  return all;
}

// Keeps what it drops as bytes, and drops what a ping does not ask for: the smallest cache.
struct Shelf {
  VoxelMap& map;
  std::map<BlockKey, std::string> bricks;
  std::set<BlockKey> here;
  int fetched = 0, dropped = 0;

  void fetch(const std::vector<BlockKey>& tiles) {
    const mapperd::map::ChangedBricks all = bricks_since(map, 0);
    for (const mapperd::map::Brick& brick : all.bricks) bricks[brick.key] = brick.bytes;
    const std::vector<BlockKey> gone(here.begin(), here.end());
    drop_tiles(map, gone);
    dropped += static_cast<int>(gone.size());
    std::vector<BrickView> back;
    for (const auto& [key, bytes] : bricks) {
      if (std::find(tiles.begin(), tiles.end(), key) != tiles.end()) back.push_back({key, bytes});
    }
    put_bricks(map, back, tiles);
    fetched += static_cast<int>(back.size());
    here = {tiles.begin(), tiles.end()};
  }
};

struct Shot {
  scenes::Ping ping;
  mapperd::Transform pose;
};

// There and back again through several bricks of 64 voxels.
std::vector<Shot> there_and_back() {
  scenes::Random random(77);
  std::vector<Shot> all;
  for (int i = 0; i < 10; ++i) {
    scenes::Ragged want;
    want.max_range_m = 4;
    want.beams = 48;
    want.rows = 60;
    want.surface = 0.7;
    want.thickness = 3;
    Shot shot{scenes::ragged_ping(want, random), scenes::rotation_zyx(0.4 * i, 0.2, 0.1)};
    shot.pose.translation = {3.0 * (i < 5 ? i : 9 - i), -1.0, 0.5};
    all.push_back(std::move(shot));
  }
  return all;
}

template <typename Integrate>
void check_paged(const Integrate& integrate) {
  VoxelMap whole(0.1, {}), paged(0.1, {});
  Shelf shelf{paged, {}, {}};
  paged.cut_into_tiles({mapperd::map::kBrickEdge, [&shelf](const auto& t) { shelf.fetch(t); }});
  for (const Shot& shot : there_and_back()) {
    integrate(whole, shot);
    integrate(paged, shot);
  }
  CHECK((shelf.dropped > 20 && shelf.fetched > 20));
  CHECK(paged.known_count() < whole.known_count());
  CHECK(paged.revision() == whole.revision());
  shelf.fetch({});  // the last go to the shelf too
  CHECK(paged.block_count() == 0);
  VoxelMap put_together(0.1, {});
  std::vector<BrickView> all;
  for (const auto& [key, bytes] : shelf.bricks) all.push_back({key, bytes});
  put_bricks(put_together, all);
  CHECK(encode_map(put_together) == encode_map(whole));
}

TEST_CASE("a map that fits into memory tile by tile only is the same, to the bit") {
  mapperd::map::PingParams settings;
  settings.vertical_aperture_rad = 0.5;
  check_paged([&](VoxelMap& map, const Shot& shot) {
    integrate_evidence_grid(map, shot.ping.image(), shot.pose, settings);
  });
  check_paged([](VoxelMap& map, const Shot& shot) {
    mapperd::map::RaysParams rays;
    rays.vertical_aperture_rad = 0.5;
    integrate_rays(map, shot.ping.image(), shot.pose, rays);
  });
}

TEST_CASE("a ping whose tiles cannot be fetched leaves the map alone") {
  VoxelMap map(0.1, {});
  const Shot shot = there_and_back()[0];
  int asked = 0;
  map.cut_into_tiles({4, [&asked](const std::vector<BlockKey>& tiles) {
                        asked = static_cast<int>(tiles.size());
                        throw std::runtime_error("the disk is gone");
                      }});
  mapperd::map::PingParams settings;
  settings.vertical_aperture_rad = 0.5;
  CHECK_THROWS_AS(integrate_evidence_grid(map, shot.ping.image(), shot.pose, settings),
                  std::runtime_error);
  CHECK((asked > 0 && map.block_count() == 0 && map.revision() == 0));
}

TEST_CASE("a tile that was not fetched cannot be written, and others stay") {
  VoxelMap map(0.1, {});
  map.cut_into_tiles({2, [](const std::vector<BlockKey>&) {}});
  CHECK_THROWS_AS(map.set({0, 0, 0}, {1.0F, 1}), std::logic_error);
  put_bricks(map, {}, {{0, 0, 0}});
  map.set({31, 0, 0}, {1.0F, 1});
  CHECK_THROWS_AS(map.set({32, 0, 0}, {1.0F, 1}), std::logic_error);
  CHECK_THROWS_AS(map.set({-1, 0, 0}, {1.0F, 1}), std::logic_error);
  CHECK_THROWS_AS(clear(map), std::logic_error);
  CHECK_THROWS_AS(load_map(encode_map(VoxelMap(0.1, {})), map), std::logic_error);
  CHECK_THROWS_AS(map.cut_into_tiles({2, [](const std::vector<BlockKey>&) {}}), std::logic_error);
  CHECK(map.known_count() == 1);
  drop_tiles(map, {{0, 0, 0}});
  CHECK((map.block_count() == 0 && map.at(mapperd::map::VoxelIndex{31, 0, 0}).count == 0));
}

TEST_CASE("tiles are counted from the origin to both sides") {
  const mapperd::map::Residency tiles(5, [](const std::vector<BlockKey>&) {});
  for (int i = -23; i < 23; ++i) {
    const int tile = static_cast<int>(std::floor(i / 5.0));
    CHECK((tiles.tile_holding({i, -i, 0}) ==
           BlockKey{tile, static_cast<int>(std::floor(-i / 5.0)), 0}));
  }
}

TEST_CASE("only bricks with a changed block are asked for, and each comes back whole") {
  VoxelMap map = maps::random_map(5, 3000, 100);
  const std::uint64_t before = map.revision();
  CHECK(bricks_since(map, before).bricks.empty());
  map.set({-1, 0, 0}, {2.0F, 9});
  map.set({70, 0, 0}, {2.0F, 9});
  const mapperd::map::ChangedBricks changed = bricks_since(map, before);
  CHECK((changed.bricks.size() == 2 && changed.revision == map.revision()));
  CHECK(
      (changed.bricks[0].key == BlockKey{-1, 0, 0} && changed.bricks[1].key == BlockKey{1, 0, 0}));
  CHECK((changed.bricks[0].revision == before + 1 && changed.bricks[1].revision == before + 2));
  VoxelMap copy(0.1, {});
  put_bricks(copy, views(bricks_since(map, 0)));
  CHECK((encode_map(copy) == encode_map(map) && copy.revision() == map.revision()));
  for (const mapperd::map::Block* block : map.sorted_blocks()) {
    CHECK(copy.find(block->key)->revision == block->revision);
  }
}

TEST_CASE("a brick that is put replaces what was there") {
  VoxelMap map(0.1, {}), other(0.1, {});
  map.set({1, 1, 1}, {2.0F, 9});
  map.set({40, 1, 1}, {2.0F, 9});
  map.set({64, 1, 1}, {2.0F, 9});
  other.set({2, 2, 2}, {-1.0F, 3});
  put_bricks(map, views(bricks_since(other, 0)));
  CHECK(map.known_count() == 2);
  CHECK(map.at(mapperd::map::VoxelIndex{2, 2, 2}).count == 3);
  CHECK(map.at(mapperd::map::VoxelIndex{64, 1, 1}).count == 9);
}

TEST_CASE("dropping tiles finds the others again, wherever they were held") {
  VoxelMap map(0.1, {});
  map.cut_into_tiles({1, [](const std::vector<BlockKey>&) {}});
  std::vector<BlockKey> tiles, even;
  for (int i = -60; i < 60; ++i) {
    tiles.push_back({i, i % 3, 0});
    if (i % 2 == 0) even.push_back(tiles.back());
  }
  put_bricks(map, {}, tiles);
  for (const BlockKey& tile : tiles) map.set({16LL * tile.x, 16LL * tile.y, 0}, {1.0F, 5});
  drop_tiles(map, even);
  CHECK(map.block_count() == tiles.size() - even.size());
  for (const BlockKey& tile : tiles) {
    CHECK((map.find(tile) != nullptr) == (tile.x % 2 != 0));
    CHECK((map.find(tile) == nullptr || map.find(tile)->known_count(map.pool()) == 1));
  }
}

TEST_CASE("bytes that are no brick are refused, and the map is as before") {
  VoxelMap source = maps::random_map(9, 300, 60);
  const mapperd::map::ChangedBricks good = bricks_since(source, 0);
  VoxelMap map(0.1, {});
  map.set({1, 2, 3}, {2.0F, 7});
  const std::string before = encode_map(map);
  const auto refused = [&](const BlockKey& key, const std::string& bytes) {
    try {
      put_bricks(map, {{good.bricks[0].key, good.bricks[0].bytes}, {key, bytes}});
    } catch (const std::invalid_argument&) {
      return encode_map(map) == before;
    }
    return false;
  };
  const std::string& whole = good.bricks[1].bytes;
  for (std::size_t size = 0; size < whole.size(); size += size < 40 ? 1 : 37) {
    CHECK(refused({0, 0, 0}, whole.substr(0, size)));
  }
  CHECK(refused({0, 0, 0}, whole + '\0'));
  CHECK(refused({mapperd::map::kMaxBlock, 0, 0}, whole));
  std::string twice = std::string(1, '\2');
  for (int i = 0; i < 2; ++i) {
    twice.push_back('\5');
    mapperd::map::put(twice, std::uint64_t{1});
    twice.push_back('\1');
    mapperd::map::put(twice, std::int32_t{5});
    mapperd::map::put(twice, std::uint16_t{1});
  }
  CHECK(refused({0, 0, 0}, twice));
  twice[1] = '\4';
  CHECK(!refused({0, 0, 0}, twice));
}

}  // namespace
