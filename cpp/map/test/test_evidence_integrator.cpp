// What the integrator refuses, and what it leaves alone.
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <thread>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/rays.hpp"
#include "maps.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::PingParams;
using mapperd::map::PingStats;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;

TEST_CASE("a bad ping or pose is refused and leaves the map alone") {
  const double not_a_number = std::numeric_limits<double>::quiet_NaN();
  VoxelMap map(0.1, {});
  scenes::Ping ping = scenes::empty_ping(10, 8, 0.5, 2.0);
  ping.intensity.assign(80, 200.0F);
  const auto refuses = [&](const scenes::Ping& p, const mapperd::Transform& pose) {
    CHECK_THROWS_AS(integrate_evidence_grid(map, p.image(), pose, {}), std::logic_error);
    CHECK_THROWS_AS(integrate_rays(map, p.image(), pose, {}), std::logic_error);
    CHECK((map.block_count() == 0 && map.revision() == 0));
  };
  mapperd::Transform pose;
  pose.translation.y = not_a_number;
  refuses(ping, pose);
  pose.translation.y = 1e12;
  refuses(ping, pose);
  for (const double y : {2.0, not_a_number, 1.001, -1.0}) {
    pose = {};
    pose.rows[1].y = y;  // no rotation: longer, none, a mirror
    refuses(ping, pose);
  }
  pose = {};
  pose.rows[1] = pose.rows[0];
  refuses(ping, pose);
  scenes::Ping bad = ping;
  bad.bearings_rad[3] = bad.bearings_rad[2];
  refuses(bad, {});
  bad = ping;
  bad.bearings_rad[0] = not_a_number;
  refuses(bad, {});
  for (const double length : {not_a_number, -0.1, 0.0}) {
    bad = ping;
    bad.range_resolution_m = length;
    refuses(bad, {});
  }
  for (const double detail : {not_a_number, 0.0, 100.0, -1.0}) {
    PingParams settings;
    settings.detail = detail;
    CHECK_THROWS_AS(integrate_evidence_grid(map, ping.image(), {}, settings),
                    std::invalid_argument);
  }
}

TEST_CASE("a grid too fine for the memory is refused before anything is changed") {
  VoxelMap map(0.001, {});
  scenes::Ping ping = scenes::empty_ping(200, 512, 1.1, 200.0);
  ping.intensity.assign(200 * 512, 200.0F);
  CHECK_THROWS_AS(integrate_evidence_grid(map, ping.image(), {}, {}), std::invalid_argument);
  CHECK((map.block_count() == 0 && map.revision() == 0));
}

TEST_CASE("no intensity brings a NaN into the map") {
  VoxelMap map(0.1, {});
  scenes::Ping ping = scenes::empty_ping(20, 16, 0.5, 2.0);
  const float values[] = {std::numeric_limits<float>::quiet_NaN(),
                          std::numeric_limits<float>::infinity(),
                          -std::numeric_limits<float>::infinity(),
                          1e30F,
                          200.0F,
                          0.0F};
  for (std::size_t i = 0; i < ping.intensity.size(); ++i) ping.intensity[i] = values[i % 6];
  PingParams mean;
  mean.aggregation = mapperd::map::Aggregation::kMean;
  for (int i = 0; i < 5; ++i) {
    integrate_evidence_grid(map, ping.image(), {}, {});
    integrate_evidence_grid(map, ping.image(), {}, mean);
  }
  CHECK(map.block_count() > 0);
  map.for_each_known(
      [](const VoxelIndex&, const VoxelState& state) { CHECK(std::abs(state.log_odds) <= 10.0F); });
}

TEST_CASE("what is settled does not change any more, nor does its revision") {
  scenes::Random random(91);
  const scenes::Ping ping = scenes::empty_ping(40, 32, 0.6, 4.0);
  PingParams settings;
  settings.carve_no_return = true;
  const mapperd::Transform pose = scenes::random_pose(random);
  VoxelMap map(0.05, {});
  const auto last_change = [&map] {
    std::uint64_t latest = 0;
    for (const mapperd::map::Block* block : map.sorted_blocks()) {
      latest = std::max(latest, block->revision);
    }
    return latest;
  };
  const std::uint32_t pings = map.rule().free_steps_to_floor();
  for (std::uint32_t i = 0; i < pings; ++i)
    integrate_evidence_grid(map, ping.image(), pose, settings);
  CHECK(last_change() > 80);  // counts settle after 90 pings
  const std::uint64_t settled = last_change();
  CHECK(settled <= map.revision());
  for (int i = 0; i < 5; ++i) {
    integrate_evidence_grid(map, ping.image(), pose, settings);
    CHECK(last_change() == settled);
  }
}

TEST_CASE("looking at nothing creates no block") {
  VoxelMap map(0.1, {});
  const scenes::Ping ping = scenes::empty_ping(20, 16, 0.5, 2.0);
  CHECK(integrate_evidence_grid(map, ping.image(), {}, {}).free == 0);
  CHECK(map.block_count() == 0);
  PingParams carve;
  carve.carve_no_return = true;
  CHECK(integrate_evidence_grid(map, ping.image(), {}, carve).free > 100);
}

TEST_CASE("the numbers returned are those of the voxels changed") {
  scenes::Random random(17);
  for (int i = 0; i < 12; ++i) {
    const scenes::Ping ping = scenes::random_ping(random);
    PingParams settings;
    settings.vertical_aperture_rad = random.uniform(0.1, 0.9);
    settings.carve_no_return = i % 2 == 0;
    settings.threads = 1 + i % 3;
    VoxelMap map(0.04, {});
    const PingStats stats =
        integrate_evidence_grid(map, ping.image(), scenes::random_pose(random), settings);
    std::size_t occupied = 0, free = 0;
    map.for_each_known([&](const VoxelIndex&, const VoxelState& state) {
      ++(state.log_odds > 0 ? occupied : free);
      CHECK(state.count == 1);
    });
    CHECK((stats.occupied == occupied && stats.free == free && occupied > 0));
    CHECK(stats.blocks_created == map.block_count());
    CHECK(stats.blocks_visited >= stats.blocks_created);
    for (const mapperd::map::Block* block : map.sorted_blocks()) {
      CHECK((block->known_count(map.pool()) > 0 && block->revision == 1));
    }
  }
}

TEST_CASE("a ping does not depend on those before it, but for the voxels") {
  scenes::Random random(18);
  for (int i = 0; i < 8; ++i) {
    VoxelMap alone(0.05, {}), after(0.05, {});
    PingParams mean;
    mean.aggregation = mapperd::map::Aggregation::kMean;
    const scenes::Ping other = scenes::random_ping(random);
    integrate_evidence_grid(after, other.image(), scenes::random_pose(random),
                            i % 2 == 0 ? mean : PingParams{});
    clear(after);
    const scenes::Ping ping = scenes::random_ping(random);
    const mapperd::Transform pose = scenes::random_pose(random);
    const PingParams settings = i % 3 == 0 ? mean : PingParams{};
    integrate_evidence_grid(after, ping.image(), pose, settings);
    // A thread of its own has memory of its own.
    std::thread([&] { integrate_evidence_grid(alone, ping.image(), pose, settings); }).join();
    CHECK((alone.known_count() > 100 && encode_map(alone) == encode_map(after)));
  }
}

}  // namespace
