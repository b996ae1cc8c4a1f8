// Map files: without loss, equal for equal maps, and refused when malformed.
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "mapperd/map/bytes.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/snapshot.hpp"
#include "maps.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::IwloParams;
using mapperd::map::VoxelMap;

constexpr std::size_t kHeaderBytes = 8 + 4 + 8 + 4 + 4 + 2 + 8;

// A map of few blocks: two scattered, one full, one alike, one far away.
VoxelMap small_map() {
  VoxelMap map = maps::random_map(3, 12, 5);
  maps::change_block(map, {7, 0, 0}, [](int i, std::int16_t& units, std::uint16_t& count) {
    units = static_cast<std::int16_t>(9 * i - 18000);
    count = static_cast<std::uint16_t>(1 + i % 90);
  });
  maps::see_free(map, {-9, 4, 2});
  map.get_or_create({1, 1, 1});  // nothing in it
  map.set({16LL * mapperd::map::kMaxBlock, 0, 0}, {-10.0F, 90});
  return map;
}

std::string with_checksum(std::string content) {
  mapperd::map::put(content, mapperd::map::crc32(content));
  return content;
}

std::string content_of(const VoxelMap& map) {
  const std::string file = encode_map(map);
  return file.substr(0, file.size() - 4);
}

// What the file is refused with; the map must not change by that. Empty when it is taken.
std::string refusal_of(const std::string& file, VoxelMap& map) {
  const std::string before = encode_map(map);
  const std::uint64_t revision = map.revision();
  try {
    load_map(file, map);
  } catch (const std::invalid_argument& error) {
    CHECK((encode_map(map) == before && map.revision() == revision));
    return error.what();
  }
  return "";
}

std::string refusal_of(const std::string& file) {
  VoxelMap map(0.1, {});
  map.set({1, 2, 3}, {2.0F, 7});
  return refusal_of(file, map);
}

bool contains(const std::string& refusal, const char* what) {
  return refusal.find("map file: ") == 0 && refusal.find(what) != std::string::npos;
}

TEST_CASE("the checksum is zlib's") {
  CHECK(mapperd::map::crc32("") == 0);
  CHECK(mapperd::map::crc32("123456789") == 0xCBF43926U);  // the catalogued check value
}

TEST_CASE("a map comes back from its file, to the bit") {
  VoxelMap map = small_map();
  maps::change_block(map, {8, 0, 0}, [](int i, std::int16_t& units, std::uint16_t& count) {
    units = 1000;
    count = i == 7 ? 4 : 3;  // alike but for one
  });
  VoxelMap loaded(0.1, {});
  loaded.set({5000, 0, 0}, {1.0F, 1});  // must go
  const std::uint64_t revision = loaded.revision();
  load_map(encode_map(map), loaded);
  CHECK(maps::content(loaded) == maps::content(map));
  CHECK(known_count(loaded) == known_count(map));
  CHECK(encode_map(loaded) == encode_map(map));
  CHECK(loaded.revision() == revision + 1);
  CHECK(loaded.find({7, 0, 0})->revision == loaded.revision());
  CHECK(loaded.find({1, 1, 1}) == nullptr);
}

TEST_CASE("an empty map is a header and a checksum, and empties what loads it") {
  const std::string file = encode_map(VoxelMap(0.1, {}));
  CHECK(file.size() == kHeaderBytes + 4);
  VoxelMap map = small_map();
  load_map(file, map);
  CHECK(map.block_count() == 0);
}

TEST_CASE("free water is a few bytes a block") {
  VoxelMap map(0.1, {});
  for (int i = 0; i < 100; ++i) maps::see_free(map, {i, 0, 0});
  CHECK(encode_map(map).size() == kHeaderBytes + 100 * (12 + 6) + 4);
}

TEST_CASE("equal blocks are equal bytes, whether they know that they are alike or not") {
  VoxelMap pending(0.1, {}), plain(0.1, {});
  pending.set({5, 0, 0}, {0.5F, 1});  // differs, until free pings bring all to the clamp
  for (int i = 0; i < 120; ++i) {
    maps::see_free(pending, {0, 0, 0});
    maps::see_free(plain, {0, 0, 0});
  }
  CHECK((pending.find({0, 0, 0})->held() != 0 && plain.find({0, 0, 0})->held() == 0));
  CHECK(encode_map(pending) == encode_map(plain));
}

TEST_CASE("maps of another kind are refused by what differs") {
  const std::string file = encode_map(small_map());
  VoxelMap coarse(0.2, {});
  CHECK(contains(refusal_of(file, coarse), "its voxels are 0.1"));
  IwloParams clamps, counts;
  clamps.L_max = 9.0;
  counts.decay_rate = 0.2;
  VoxelMap clamped(0.1, clamps), counted(0.1, counts);
  CHECK(contains(refusal_of(file, clamped), "its clamps (L_min, L_max) are -10 and 10"));
  CHECK(contains(refusal_of(file, counted), "it counts to 90"));
}

TEST_CASE("what is not a map file is refused") {
  CHECK(contains(refusal_of(""), "no map of mapperd"));
  CHECK(contains(refusal_of("# Octomap OcTree file\n"), "no map of mapperd"));
  CHECK(contains(refusal_of(std::string(mapperd::map::kMapFileMagic)), "ends too early"));
  std::string newer = content_of(small_map());
  newer[8] = 3;
  CHECK(contains(refusal_of(with_checksum(newer)), "version 3"));
}

TEST_CASE("a file cut off anywhere is refused, and so is one with a byte too many") {
  const std::string file = encode_map(small_map());
  for (std::size_t size = 0; size < file.size(); size += size < 200 ? 1 : 97) {
    CHECK(!refusal_of(file.substr(0, size)).empty());
  }
  CHECK(!refusal_of(file.substr(0, file.size() - 1)).empty());
  CHECK(contains(refusal_of(file + '\0'), "checksum"));
}

TEST_CASE("a changed bit is found wherever it is") {
  const std::string file = encode_map(small_map());
  for (std::size_t at = 0; at < file.size(); at += at < 200 ? 1 : 61) {
    std::string changed = file;
    changed[at] = static_cast<char>(changed[at] ^ 1 << at % 8);
    CHECK(!refusal_of(changed).empty());
  }
}

// Contents that carry a true checksum, so that the reader behind it has to judge them.
TEST_CASE("what a block must not be is refused with its place") {
  const std::string header = content_of(VoxelMap(0.1, {})).substr(0, kHeaderBytes - 8);
  const auto file = [&](std::uint64_t blocks, const std::string& data) {
    std::string content = header;
    mapperd::map::put(content, blocks);
    return with_checksum(content + data);
  };
  const auto alike = [](std::int32_t x, std::int32_t units, std::uint16_t count) {
    std::string block;
    for (const std::int32_t coordinate : {x, 0, 0}) mapperd::map::put(block, coordinate);
    block.push_back(1);
    mapperd::map::put(block, units);
    mapperd::map::put(block, count);
    return block;
  };
  CHECK(refusal_of(file(2, alike(0, 5, 1) + alike(1, 5, 1))).empty());
  CHECK(contains(refusal_of(file(0, alike(0, 5, 1))), "bytes follow"));
  CHECK(contains(refusal_of(file(2, alike(0, 5, 1))), "more blocks than bytes"));
  CHECK(contains(refusal_of(file(std::numeric_limits<std::uint64_t>::max(), alike(0, 5, 1))),
                 "more blocks than bytes"));
  CHECK(contains(refusal_of(file(2, alike(1, 5, 1) + alike(1, 5, 1))),
                 "byte 69: blocks out of order"));
  CHECK(contains(refusal_of(file(2, alike(1, 5, 1) + alike(0, 5, 1))), "out of order"));
  CHECK(contains(refusal_of(file(1, alike(mapperd::map::kMaxBlock + 1, 5, 1))),
                 "beyond the map's reach"));
  CHECK(contains(refusal_of(file(1, alike(0, 5, 0))), "count 0"));
  CHECK(contains(refusal_of(file(1, alike(0, 5, 91))), "settled"));
  // Half a unit of the map is 2^12 of these.
  CHECK(refusal_of(file(1, alike(0, 10 * (1 << 24) + 4095, 1))).empty());
  CHECK(contains(refusal_of(file(1, alike(0, 10 * (1 << 24) + 4096, 1))), "clamps"));
  CHECK(refusal_of(file(1, alike(0, -10 * (1 << 24) - 4096, 1))).empty());
  CHECK(contains(refusal_of(file(1, alike(0, -10 * (1 << 24) - 4097, 1))), "clamps"));
  std::string strange = alike(0, 5, 1);
  strange[12] = 6;
  CHECK(contains(refusal_of(file(1, strange)), "does not know"));
  std::string unknown = alike(0, 5, 1).substr(0, 12) + '\2' + std::string(512, '\0');
  CHECK(contains(refusal_of(file(1, unknown)), "without observed voxels"));
  unknown[13] = 1;
  CHECK(contains(refusal_of(file(1, unknown)), "end too early"));
}

// Blocks as this version does not write them any more, and as it does, put together by hand.
TEST_CASE("every form of a block is read, with the state of every voxel") {
  const std::string header = content_of(VoxelMap(0.1, {})).substr(0, kHeaderBytes - 8);
  const auto loaded = [&](const std::string& block) {
    std::string content = header;
    mapperd::map::put(content, std::uint64_t{1});
    for (int axis = 0; axis < 3; ++axis) mapperd::map::put(content, std::int32_t{0});
    VoxelMap map(0.1, {});
    CHECK(refusal_of(with_checksum(content + block), map).empty());
    return map;
  };
  const auto state = [](const VoxelMap& map, int offset) {
    return map.voxel(*map.find({0, 0, 0}), offset);
  };
  using mapperd::map::put;
  using mapperd::map::Voxel;
  constexpr std::int32_t kUnit = 1 << 13;  // of the map, in those of the old forms

  std::string old_alike(1, '\1');
  put(old_alike, std::int32_t{-3 * kUnit - kUnit / 2 + 1});  // rounds to the nearest
  put(old_alike, std::uint16_t{7});
  const VoxelMap alike = loaded(old_alike);
  for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) CHECK((state(alike, i) == Voxel{-3, 7}));

  std::string old_one_by_one(1, '\2');
  std::vector<int> known;
  for (int byte = 0; byte < 512; ++byte) {
    const auto bits = static_cast<std::uint8_t>(byte * 37 % 5 == 0 ? byte * 13 : 0);
    put(old_one_by_one, bits);
    for (int bit = 0; bit < 8; ++bit) {
      if ((bits >> bit & 1) != 0) known.push_back(8 * byte + bit);
    }
  }
  for (const int i : known) put(old_one_by_one, std::int32_t{(3 * i - 6000) * kUnit + kUnit / 4});
  for (const int i : known) put(old_one_by_one, static_cast<std::uint16_t>(1 + i % 90));
  const VoxelMap one_by_one = loaded(old_one_by_one);
  std::size_t next = 0;
  for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) {
    Voxel expected;
    if (next < known.size() && known[next] == i) {
      expected = {static_cast<std::int16_t>(3 * i - 6000), static_cast<std::uint16_t>(1 + i % 90)};
      ++next;
    }
    CHECK(state(one_by_one, i) == expected);
  }
  CHECK((next == known.size() && next > 100));

  // In units of 2^-8, of a map with wider clamps: eight of ours each.
  std::string new_alike("\3\x08", 2);
  put(new_alike, std::int16_t{-21});
  put(new_alike, std::uint16_t{90});
  CHECK((state(loaded(new_alike), 4095) == Voxel{-168, 90}));

  for (const bool wide : {false, true}) {
    std::string cells(1, wide ? '\5' : '\4');
    put(cells, std::uint8_t{11});
    put(cells, std::uint64_t{1} << 63);  // alike
    put(cells, std::uint64_t{1} << 1);   // voxel by voxel
    for (int v = 0; v < 64; ++v) put(cells, static_cast<std::int16_t>(v % 3 == 0 ? 0 : 100 * v));
    for (int v = 0; v < 64; ++v) {
      const int count = v % 3 == 0 ? 0 : v;
      if (wide) put(cells, static_cast<std::uint16_t>(count));
      if (!wide) put(cells, static_cast<std::uint8_t>(count));
    }
    put(cells, std::int16_t{-5});
    put(cells, std::uint16_t{2});
    const VoxelMap map = loaded(cells);
    for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) {
      const int x = i % 16, y = i / 16 % 16, z = i / 256;
      const int cell = x / 4 + 4 * (y / 4) + 16 * (z / 4), v = x % 4 + 4 * (y % 4) + 16 * (z % 4);
      Voxel expected;
      if (cell == 63) expected = {-5, 2};
      if (cell == 1 && v % 3 != 0) {
        expected = {static_cast<std::int16_t>(100 * v), static_cast<std::uint16_t>(v)};
      }
      CHECK(state(map, i) == expected);
    }
    if (wide) continue;
    const std::string file = encode_map(map);  // and is what is written
    CHECK(file.substr(kHeaderBytes + 12, cells.size()) == cells);
  }
}

TEST_CASE("counts of two bytes come back") {
  IwloParams slow;
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;
  VoxelMap map(0.1, slow), loaded(0.1, slow);
  CHECK(map.rule().count_bytes() == 2);
  scenes::Random random(8);
  for (int i = 0; i < 3000; ++i) {
    map.set({random.integer(0, 30), random.integer(0, 30), random.integer(-30, 0)},
            {static_cast<float>(random.uniform(-9, 9)),
             static_cast<std::uint16_t>(random.integer(1, 49900))});
  }
  load_map(encode_map(map), loaded);
  CHECK((maps::content(loaded) == maps::content(map) && encode_map(loaded) == encode_map(map)));
}

TEST_CASE("mutated contents are read or refused, never more") {
  const std::string content = content_of(small_map());
  scenes::Random random(41);
  int taken = 0;
  for (int i = 0; i < 3000; ++i) {
    std::string mutated = content;
    const int changes = random.integer(1, 4);
    for (int change = 0; change < changes; ++change) {
      const auto last = static_cast<int>(mutated.size()) - 1;
      // Mostly near the front, where the header and the keys are.
      const auto at = static_cast<std::size_t>(
          random.integer(0, random.integer(0, 1) == 0 ? last : std::min(last, 120)));
      const int kind = random.integer(0, 3);
      if (kind == 0) mutated[at] = static_cast<char>(random.integer(-128, 127));
      if (kind == 1) mutated.erase(at, static_cast<std::size_t>(random.integer(1, 40)));
      if (kind == 2) mutated.insert(at, static_cast<std::size_t>(random.integer(1, 40)), '\xFF');
      if (kind == 3) mutated.resize(std::max<std::size_t>(at, 1));
    }
    VoxelMap map(0.1, {});
    map.set({1, 2, 3}, {2.0F, 7});
    if (!refusal_of(with_checksum(mutated), map).empty()) continue;
    ++taken;
    CHECK(encode_map(map).size() <= mutated.size() + 4);
    map.for_each_known(
        [&map](const mapperd::map::VoxelIndex&, const mapperd::map::VoxelState& state) {
          CHECK((std::abs(state.log_odds) <= 10.0F && state.count <= map.rule().settled_count()));
        });
  }
  CHECK((taken > 30 && taken < 2000));
}

}  // namespace
