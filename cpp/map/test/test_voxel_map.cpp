#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/voxel_map.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;

TEST_CASE("voxels are found again among thousands of blocks, near and far") {
  VoxelMap map(0.05, {});
  scenes::Random random(3);
  std::map<std::array<int, 3>, float> expected;
  for (int i = 0; i < 4000; ++i) {
    const int spread = i % 2 == 0 ? 100 : mapperd::map::kMaxBlock;
    const std::array<int, 3> at{random.integer(-spread, spread), random.integer(-spread, spread),
                                random.integer(-spread, spread)};
    const float value = static_cast<float>(i) / 512.0F;
    map.set({at[0], at[1], at[2]}, {value, 1});
    expected[at] = value;
  }
  for (const auto& [at, value] : expected) {
    CHECK(map.at(VoxelIndex{at[0], at[1], at[2]}).log_odds == near(value, 1e-6));
    CHECK(map.at(map.centre_of({at[0], at[1], at[2]})).count == 1);
  }
  std::size_t known = 0;
  map.for_each_known([&known](const VoxelIndex&, const mapperd::map::VoxelState&) { ++known; });
  CHECK(known == expected.size());
  CHECK(map.at(VoxelIndex{1, 1, 12345}).count == 0);
  CHECK(map.memory_bytes() >
        map.block_count() * (sizeof(mapperd::map::Block) + 3 * mapperd::map::kCellVoxels));
  map.clear();
  CHECK(map.block_count() == 0);
}

TEST_CASE("points and blocks beyond the reach are unknown or refused") {
  VoxelMap map(0.05, {});
  CHECK(map.at(mapperd::Vec3{1e30, 0, 0}).count == 0);
  CHECK(map.at(mapperd::Vec3{std::numeric_limits<double>::quiet_NaN(), 0, 0}).count == 0);
  mapperd::map::VoxelIndex voxel{};
  for (const double none : {std::numeric_limits<double>::quiet_NaN(), 1e30, -1e30,
                            std::numeric_limits<double>::infinity()}) {
    CHECK(!map.index_of({none, 0, 0}, voxel));
    CHECK(!map.index_of({0, none, 0}, voxel));
    CHECK(!map.index_of({0, 0, none}, voxel));
  }
  CHECK_THROWS_AS(map.get_or_create({mapperd::map::kMaxBlock + 1, 0, 0}), std::out_of_range);
  CHECK(map.block_count() == 0);
}

TEST_CASE("a block's revision is that of its last change") {
  mapperd::map::IwloParams quick;  // saturates after some twenty pings
  quick.decay_rate = 1.0;
  quick.min_alpha = 0.5;
  VoxelMap map(0.1, quick);
  // Free water, and far from it a wall that goes away after two pings.
  const scenes::Ping water = scenes::empty_ping(30, 8, 1.0, 6.0);
  mapperd::map::PingParams settings;
  settings.vertical_aperture_rad = 1.2;
  settings.carve_no_return = true;
  mapperd::Transform here, there;
  here.translation = {0.8, 0.8, 0.8};
  there.translation = {100.8, 0.8, 0.8};
  scenes::Ping wall = water;
  for (std::size_t j = 0; j < 8; ++j) wall.intensity[15 * 8 + j] = 50.0F;
  for (int i = 0; i < 2; ++i) integrate_evidence_grid(map, wall.image(), here, settings);
  const std::uint64_t of_wall = map.revision();
  const mapperd::map::BlockKey key{2, 0, 0};
  CHECK((map.find(key)->held() != 0 && map.find(key)->revision == of_wall));
  integrate_evidence_grid(map, water.image(), there, settings);
  CHECK(map.revision() > of_wall);
  CHECK(map.find(key)->revision == of_wall);
  CHECK(map.find({65, 0, 0})->revision == map.revision());
  for (int i = 0; i < 30; ++i) integrate_evidence_grid(map, water.image(), here, settings);
  CHECK(map.find(key)->held() == 0);
  const std::uint64_t settled = map.find(key)->revision;
  CHECK((settled > of_wall && settled < map.revision()));
  // Nor does a ping change it that ends within it.
  integrate_evidence_grid(map, scenes::empty_ping(14, 8, 1.0, 2.8).image(), here, settings);
  CHECK(map.find(key)->revision == settled);
}

TEST_CASE("states from elsewhere are brought inside the clamps and the settled count") {
  VoxelMap map(0.1, {});
  map.set({0, 0, 0}, {50.0F, 60000});
  map.set({1, 0, 0}, {-50.0F, 1});
  CHECK(map.at(VoxelIndex{0, 0, 0}).log_odds == 10.0F);
  CHECK(map.at(VoxelIndex{0, 0, 0}).count == map.rule().settled_count());
  CHECK(map.at(VoxelIndex{1, 0, 0}).log_odds == -10.0F);
}

TEST_CASE("a resolution that is no length is refused") {
  CHECK_THROWS_AS(VoxelMap(0.0, {}), std::invalid_argument);
  CHECK_THROWS_AS(VoxelMap(-0.1, {}), std::invalid_argument);
  CHECK_THROWS_AS(VoxelMap(std::numeric_limits<double>::quiet_NaN(), {}), std::invalid_argument);
  CHECK_THROWS_AS(VoxelMap(std::numeric_limits<double>::infinity(), {}), std::invalid_argument);
}

TEST_CASE("another threshold changes later pings as if the map had always had it") {
  scenes::Ping ping = scenes::empty_ping(30, 8, 1.0, 6.0);
  for (std::size_t j = 0; j < 8; ++j) ping.intensity[15 * 8 + j] = 50.0F;
  mapperd::map::PingParams settings;
  settings.vertical_aperture_rad = 1.2;
  const mapperd::Transform here;
  mapperd::map::IwloParams above, below;
  above.intensity_threshold = 60;
  below.intensity_threshold = 40;
  VoxelMap changed(0.2, above), always(0.2, below);
  CHECK(integrate_evidence_grid(changed, ping.image(), here, settings).occupied == 0);
  mapperd::map::clear(changed);
  mapperd::map::set_intensity_threshold(changed, 40);
  CHECK(integrate_evidence_grid(changed, ping.image(), here, settings).occupied > 0);
  integrate_evidence_grid(always, ping.image(), here, settings);
  CHECK(changed.known_count() == always.known_count());
  bool equal = true;
  always.for_each_known(
      [&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
        const mapperd::map::VoxelState other = changed.at(voxel);
        equal = equal && other.log_odds == state.log_odds && other.count == state.count;
      });
  CHECK(equal);
  CHECK_THROWS_AS(mapperd::map::set_intensity_threshold(changed, std::nan("")),
                  std::invalid_argument);
  CHECK(changed.rule().params().intensity_threshold == 40);
}

}  // namespace
