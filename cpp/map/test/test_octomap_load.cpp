// The reader of .bt and .ot: our own files come back, and anything else is refused in words.
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>

#include "mapperd/map/octomap_file.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::IwloParams;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;

constexpr double kOccupied = 0.8;
constexpr float kBtFree = -2.0F;  // to two digits: see OctoMap's own in test_octomap_reads.cpp
constexpr float kBtOccupied = 3.5F;

std::string header(bool binary, const std::string& size, const std::string& res = "0.5",
                   const std::string& id = "OcTree") {
  return std::string(binary ? "# Octomap OcTree binary file" : "# Octomap OcTree file") + "\nid " +
         id + "\nsize " + size + "\nres " + res + "\ndata\n";
}

std::string bt_record(unsigned bits) {
  return {static_cast<char>(bits & 0xFFU), static_cast<char>(bits >> 8U)};
}

std::string ot_record(unsigned value_bits, unsigned mask) {
  std::string record;
  for (unsigned i = 0; i < 4; ++i) record += static_cast<char>(value_bits >> (8 * i) & 0xFFU);
  return record + static_cast<char>(mask);
}
constexpr unsigned kOne = 0x3F800000;  // 1.0F

// `depth` inner nodes, each the first child of the one before.
std::string bt_chain(int depth) {
  std::string chain;
  for (int d = 0; d < depth; ++d) chain += bt_record(3);
  return chain;
}
std::string ot_chain(int depth) {
  std::string chain;
  for (int d = 0; d < depth; ++d) chain += ot_record(kOne, 1);
  return chain;
}

// Clusters with equal neighbours, so that pruning has something to do, on both sides of 0.
VoxelMap random_map(std::uint64_t seed, double resolution_m = 0.5) {
  scenes::Random random(seed);
  VoxelMap map(resolution_m, {});
  for (int cluster = 0; cluster < 6; ++cluster) {
    const VoxelIndex corner{random.integer(-90, 90), random.integer(-90, 90),
                            random.integer(-90, 90)};
    const auto even = static_cast<float>(random.uniform(-9, 9));
    const bool speckled = random.integer(0, 1) == 1;
    for (int i = 0; i < 10 * 10 * 10; ++i) {
      const float log_odds = speckled && random.integer(0, 9) == 0
                                 ? static_cast<float>(random.uniform(-10, 10))
                                 : even;
      map.set({corner.x + i % 10, corner.y + i / 10 % 10, corner.z + i / 100},
              {log_odds, static_cast<std::uint16_t>(random.integer(1, 9))});
    }
  }
  return map;
}

using Contents = std::map<std::array<std::int64_t, 3>, float>;

Contents contents_of(const VoxelMap& map) {
  Contents contents;
  map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
    contents[{voxel.x, voxel.y, voxel.z}] = state.log_odds;
  });
  return contents;
}

// The message of the refusal, or empty. A refusal leaves the map as it was.
std::string refusal_of(std::string_view file,
                       std::uint64_t max_voxels = mapperd::map::kMaxOctomapVoxels) {
  VoxelMap map(0.5, {});
  map.set({1, 2, 3}, {2.0F, 7});
  try {
    load_octomap(file, map, max_voxels);
  } catch (const std::invalid_argument& error) {
    CHECK(map.at(VoxelIndex{1, 2, 3}).log_odds == 2.0F);
    CHECK(map.at(VoxelIndex{1, 2, 3}).count == 7);
    CHECK(contents_of(map).size() == 1);
    return error.what();
  }
  return "";
}

void check_refused(std::string_view file, const std::string& because) {
  const std::string refusal = refusal_of(file);
  CAPTURE(refusal);
  CHECK(refusal.find(because) != std::string::npos);
  CHECK(refusal.find("OctoMap file, byte ") == 0);
}

TEST_CASE("a .ot comes back with its log-odds, each observed once") {
  for (std::uint64_t seed = 0; seed < 5; ++seed) {
    const VoxelMap written = random_map(seed);
    VoxelMap read(0.5, {});
    read.set({5000, 0, 0}, {1.0F, 1});  // must go
    load_octomap(octomap_ot(written), read);
    CHECK(contents_of(read) == contents_of(written));
    read.for_each_known(
        [](const VoxelIndex&, const VoxelState& state) { CHECK(state.count == 1); });
  }
}

TEST_CASE("a .bt comes back with its classes") {
  const VoxelMap written = random_map(11);
  VoxelMap read(0.5, {});
  load_octomap(octomap_bt(written, kOccupied, 0.0), read);
  Contents expected;
  for (const auto& [voxel, log_odds] : contents_of(written)) {
    if (log_odds < 0.0F || log_odds > kOccupied) expected[voxel] = log_odds;
  }
  const Contents actual = contents_of(read);
  CHECK(actual.size() == expected.size());
  for (const auto& [voxel, log_odds] : actual) {
    CHECK(expected.count(voxel) == 1);
    CHECK(log_odds == near(expected[voxel] > kOccupied ? kBtOccupied : kBtFree, 0.02));
  }
}

TEST_CASE("what was read and written again has the same bytes") {
  const VoxelMap map = random_map(12, 0.1);
  const std::string ot = octomap_ot(map);
  const std::string bt = octomap_bt(map, kOccupied, 0.0);
  VoxelMap read(0.1, {});
  load_octomap(ot, read);
  CHECK(octomap_ot(read) == ot);
  CHECK(octomap_bt(read, kOccupied, 0.0) == bt);
  load_octomap(bt, read);
  CHECK(octomap_bt(read, kOccupied, 0.0) == bt);
}

TEST_CASE("an empty tree empties the map") {
  for (const bool binary : {false, true}) {
    VoxelMap map = random_map(13);
    load_octomap(header(binary, "0"), map);
    CHECK(contents_of(map).empty());
  }
}

TEST_CASE("a map that reaches to the last keys comes back") {
  VoxelMap written(0.5, {});
  written.set({-32768, -32768, -32768}, {-3.0F, 1});
  written.set({32767, 32767, 32767}, {2.0F, 1});
  VoxelMap read(0.5, {});
  load_octomap(octomap_ot(written), read);
  CHECK(contents_of(read) == contents_of(written));
  load_octomap(octomap_bt(written, kOccupied, 0.0), read);
  CHECK(contents_of(read).size() == 2);
}

TEST_CASE("values beyond the map's clamps are clamped") {
  IwloParams narrow;
  narrow.L_min = -1.5;
  narrow.L_max = 2.5;
  VoxelMap map(0.5, narrow);
  const VoxelMap wide = random_map(14);
  load_octomap(octomap_ot(wide), map);
  for (const auto& [voxel, log_odds] : contents_of(wide)) {
    const VoxelIndex index{voxel[0], voxel[1], voxel[2]};
    CHECK(map.at(index).log_odds == std::min(std::max(log_odds, -1.5F), 2.5F));
  }
  load_octomap(octomap_bt(wide, kOccupied, 0.0), map);
  map.for_each_known([](const VoxelIndex&, const VoxelState& state) {
    CHECK((state.log_odds == -1.5F || state.log_odds == 2.5F));
  });
  // Infinite is what OctoMap makes of a probability of 1.
  load_octomap(header(false, "17") + ot_chain(16) + ot_record(0x7F800000, 0), map);
  CHECK(map.at(VoxelIndex{-32768, -32768, -32768}).log_odds == 2.5F);
}

TEST_CASE("leaves above the finest level become voxels, up to the limit") {
  // Depth 11: an edge of 32 voxels. Its two leaves are children 0 and 7 of the last inner node.
  const std::string file = header(true, "13") + bt_chain(10) + bt_record(0x8001);
  VoxelMap map(0.5, {});
  load_octomap(file, map, 2 * 32 * 32 * 32);
  CHECK(contents_of(map).size() == 2 * 32 * 32 * 32);
  CHECK(map.at(VoxelIndex{-32768 + 31, -32768 + 31, -32768}).log_odds == near(kBtFree, 0.02));
  CHECK(map.at(VoxelIndex{-32768 + 32, -32768 + 32, -32768 + 63}).log_odds ==
        near(kBtOccupied, 0.02));
  CHECK(map.at(VoxelIndex{-32768 + 32, -32768 + 31, -32768}).count == 0);
  CHECK(refusal_of(file, 2 * 32 * 32 * 32 - 1).find("max_voxels") != std::string::npos);
}

TEST_CASE("the limit counts the blocks that scattered voxels take") {
  VoxelMap scattered(0.5, {});
  for (int i = 0; i < 100; ++i) scattered.set({64 * i, 0, 0}, {1.0F, 1});
  const std::string file = octomap_ot(scattered);
  CHECK(refusal_of(file, 100 * 4096).empty());
  CHECK(!refusal_of(file, 100 * 4096 - 1).empty());
}

TEST_CASE("all of space in a few bytes is refused") {
  check_refused(header(false, "1") + ot_record(kOne, 0), "max_voxels");
  check_refused(header(true, "9") + bt_record(0x5555), "max_voxels");
}

TEST_CASE("what is no OctoMap file is refused") {
  for (const std::string& file :
       {std::string(), std::string("\0", 1), std::string("# Octomap OcTree"),
        std::string("id OcTree\nsize 0\nres 0.5\ndata\n"), std::string("PLY"),
        std::string(10'000, '#'), std::string(100, '\n')}) {
    check_refused(file, "no OctoMap tree");
  }
  check_refused(std::string("\3\0\0\0", 4) + std::string(16, 'x'), "convert_octree");
}

TEST_CASE("other trees of OctoMap are refused by their name") {
  check_refused(header(false, "0", "0.5", "ColorOcTree"), "'ColorOcTree'");
  check_refused(header(false, "0", "0.5", "OcTreeStamped"), "'OcTreeStamped'");
  check_refused(header(true, "0", "0.5", ""), "type ''");
  // A name of a stranger is shown short and without control codes.
  check_refused(header(false, "0", "0.5", "\x1b[2J" + std::string(5000, 'x')), "'?[2Jxxx");
  CHECK(refusal_of(header(false, "0", "0.5", std::string(5000, 'x'))).size() < 150);
  CHECK(refusal_of(header(false, "0", "0.5", "1")).empty());
}

TEST_CASE("a header of more, other or foreign lines is read as OctoMap reads it") {
  CHECK(refusal_of("# Octomap OcTree file\n# a comment\n\nres  0.5 \nauthor x\r\nsize 0\r\n"
                   "id\tOcTree\r\ndata\r\n")
            .empty());
}

TEST_CASE("a header with a field that is missing, doubled or no number is refused") {
  const std::string magic = "# Octomap OcTree file\n";
  check_refused(magic + "id OcTree\nsize 0\nres 0.5\n", "no line 'data'");
  check_refused(magic + "id OcTree\nsize 0\nres 0.5\ndata", "no line 'data'");
  check_refused(magic + "size 0\nres 0.5\ndata\n", "no line 'id'");
  check_refused(magic + "id OcTree\nres 0.5\ndata\n", "no line 'size'");
  check_refused(magic + "id OcTree\nsize 0\ndata\n", "no line 'res'");
  check_refused(magic + "id OcTree\nsize 0\nsize 0\nres 0.5\ndata\n", "size is given twice");
  for (const char* size : {"", "-1", "x", "1 2", "0x10", "1.5", "99999999999999999999"}) {
    check_refused(header(false, size), "size must be a number of nodes");
  }
  for (const char* res : {"", "0", "-0.5", "nan", "inf", "-inf", "1e999", "0.5x", "half"}) {
    check_refused(header(false, "0", res), "res must be a positive number of metres");
  }
}

TEST_CASE("another resolution is refused, the same one to OctoMap's six digits is not") {
  for (const char* res : {"0.25", "1", "1e-300", "1e300", "0.50001"}) {
    check_refused(header(true, "0", res), "the map's 0.5 m");
  }
  VoxelMap map(0.12345678, {});
  load_octomap(header(true, "0", "0.123457"), map);
  CHECK_THROWS_AS(load_octomap(header(true, "0", "0.123459"), map), std::invalid_argument);
}

TEST_CASE("a tree that ends early, late, or has another size is refused with the place") {
  const VoxelMap map = random_map(15);
  for (const std::string& file : {octomap_ot(map), octomap_bt(map, kOccupied, 0.0)}) {
    const std::size_t data = file.find("\ndata\n") + 6;
    check_refused(file.substr(0, data), "byte " + std::to_string(data) + ": the file ends inside");
    check_refused(file.substr(0, file.size() - 1), "the file ends inside");
    check_refused(file + "x", "1 bytes follow the end of the tree");
    std::string grown = file;
    grown.replace(file.find("size ") + 5, 1, "9");
    check_refused(grown, "nodes, its header states 9");
  }
  check_refused(header(false, "0") + "12345", "5 bytes follow");
}

TEST_CASE("a promise of billions of nodes is refused without room made for them") {
  for (const char* size : {"4294967295", "4294967296", "18446744073709551615"}) {
    check_refused(header(false, size), "the file ends inside the tree");
    check_refused(header(true, size) + bt_chain(15) + bt_record(1), "its header states");
  }
}

TEST_CASE("a tree of more than sixteen levels is refused") {
  check_refused(header(true, "18") + bt_chain(16) + bt_record(1), "deeper than 16");
  check_refused(header(true, "1000001") + bt_chain(1'000'000), "deeper than 16");
  check_refused(header(false, "18") + ot_chain(17) + ot_record(kOne, 0), "deeper than 16");
  check_refused(header(false, "1000001") + ot_chain(1'000'000), "deeper than 16");
}

TEST_CASE("an inner node of a .bt must have children") {
  check_refused(header(true, "1") + bt_record(0), "an inner node without children");
  check_refused(header(true, "3") + bt_chain(2) + bt_record(0), "an inner node without children");
}

TEST_CASE("log-odds that are not a number are refused, at leaves and above") {
  check_refused(header(false, "17") + ot_chain(16) + ot_record(0x7FC00000, 0), "not a number");
  check_refused(header(false, "17") + ot_chain(15) + ot_record(0xFF800001, 1) + ot_record(kOne, 0),
                "not a number");
}

// Any mutation of a file is read or refused; sanitizers watch the rest.
std::string mutated(const std::string& file, scenes::Random& random) {
  std::string bad = file;
  const auto place = [&] {
    return static_cast<std::size_t>(random.uniform(0, 1) * static_cast<double>(bad.size()));
  };
  for (int times = random.integer(1, 4); times > 0 && !bad.empty(); --times) {
    const std::size_t at = place();
    switch (random.integer(0, 4)) {
      case 0:
        bad[at] = static_cast<char>(bad[at] ^ (1 << random.integer(0, 7)));
        break;
      case 1:
        bad[at] = static_cast<char>(random.integer(-128, 127));
        break;
      case 2:
        bad.resize(at);
        break;
      case 3:
        bad.erase(at, static_cast<std::size_t>(random.integer(1, 9)));
        break;
      default:
        bad.insert(at, bad.substr(place(), static_cast<std::size_t>(random.integer(1, 30))));
    }
  }
  return bad;
}

TEST_CASE("mutated and truncated files are read or refused, never more") {
  scenes::Random random(16);
  VoxelMap small(0.5, {});
  for (int i = 0; i < 40; ++i) {
    small.set({random.integer(-3, 3), random.integer(-3, 3), random.integer(-3, 3)},
              {static_cast<float>(random.uniform(-9, 9)), 1});
  }
  int refused = 0;
  for (const std::string& file : {octomap_ot(small), octomap_bt(small, kOccupied, 0.0)}) {
    for (std::size_t size = 0; size < file.size(); ++size) {
      CHECK(!refusal_of(file.substr(0, size), 1 << 16).empty());
    }
    for (int i = 0; i < 4000; ++i) refused += !refusal_of(mutated(file, random), 1 << 16).empty();
  }
  CHECK(refused > 4000);
  CHECK(refused < 8000);
}

}  // namespace
