// The bounding box of what a ping may change.
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/ping_box.hpp"
#include "mapperd/map/rays.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::BlockBox;
using mapperd::map::PingMotion;
using mapperd::map::PingParams;
using mapperd::map::VoxelMap;

constexpr double kResolution = 0.05;
constexpr double kBlock = kResolution * mapperd::map::kBlockEdge;

// How many blocks a map has, after checking that all lie in the box.
std::size_t checked_blocks(const VoxelMap& map, const BlockBox& box) {
  for (const mapperd::map::Block* block : map.sorted_blocks()) CHECK(box.holds(block->key));
  return map.block_count();
}

void check_pings(double speed_mps, double rate_radps, bool carve) {
  scenes::Random random(77);
  std::size_t blocks = 0;
  for (int i = 0; i < 60; ++i) {
    const scenes::Ping ping = scenes::random_ping(random);
    const mapperd::Transform pose = scenes::random_pose(random);
    const PingMotion motion =
        speed_mps > 0 ? scenes::motion_of(speed_mps, rate_radps, random) : PingMotion{};
    PingParams settings;
    settings.vertical_aperture_rad = random.uniform(0.05, 1.5);
    settings.min_range_m = 0.2;
    settings.carve_no_return = carve;
    VoxelMap map(kResolution, {});
    const auto box = mapperd::map::blocks_of_ping(map, ping.image(), pose, settings, motion);
    mapperd::map::integrate_evidence_grid(map, ping.image(), pose, settings, motion);
    VoxelMap sampled(kResolution, {});
    mapperd::map::RaysParams rays;
    rays.vertical_aperture_rad = settings.vertical_aperture_rad;
    rays.min_range_m = settings.min_range_m;
    mapperd::map::integrate_rays(sampled, ping.image(), pose, rays, motion);
    if (!box) {
      CHECK(map.block_count() + sampled.block_count() == 0);
      continue;
    }
    blocks += checked_blocks(map, *box) + checked_blocks(sampled, *box);
    // No farther than the ping reaches, with room for motion and a few blocks.
    const double reach = (1.3 * ping.image().max_range_m()) / kBlock + 3;
    CHECK((box->last.x - box->first.x <= 2 * reach && box->last.z - box->first.z <= 2 * reach));
  }
  CHECK(blocks > 1000);
}

TEST_CASE("what a ping changes lies in its box") {
  check_pings(0, 0, false);
  check_pings(0, 0, true);
}

TEST_CASE("so it does where the sonar moves") {
  check_pings(4.0, 1.0, false);
  check_pings(25.0, 60.0, true);
}

TEST_CASE("the box ends where the last return does") {
  scenes::Ping ping = scenes::empty_ping(100, 32, 0.5, 10.0);
  const VoxelMap map(kResolution, {});
  PingParams settings;
  CHECK(!mapperd::map::blocks_of_ping(map, ping.image(), {}, settings));
  ping.intensity[20 * 32 + 16] = 200.0F;
  const auto near = mapperd::map::blocks_of_ping(map, ping.image(), {}, settings);
  CHECK((near && near->last.x <= static_cast<int>(2.2 / kBlock) + 2));
  CHECK((near && near->last.x >= static_cast<int>(2.1 / kBlock)));
  settings.carve_no_return = true;
  const auto far = mapperd::map::blocks_of_ping(map, ping.image(), {}, settings);
  CHECK((far && far->last.x >= static_cast<int>(9.9 / kBlock)));
}

TEST_CASE("a ping that the map would refuse has no box") {
  const scenes::Ping ping = scenes::empty_ping(100, 32, 0.5, 10.0);
  const VoxelMap map(kResolution, {});
  mapperd::Transform far;
  far.translation.y = 1e12;
  CHECK_THROWS_AS(mapperd::map::blocks_of_ping(map, ping.image(), far, {}), std::out_of_range);
  mapperd::Transform skewed;
  skewed.rows[0].y = 0.1;
  CHECK_THROWS_AS(mapperd::map::blocks_of_ping(map, ping.image(), skewed, {}),
                  std::invalid_argument);
  const PingMotion fast{{100.0, 0, 0}, {}, 0.0, 1500.0};
  CHECK_THROWS_AS(mapperd::map::blocks_of_ping(map, ping.image(), {}, {}, fast),
                  std::invalid_argument);
}

}  // namespace
