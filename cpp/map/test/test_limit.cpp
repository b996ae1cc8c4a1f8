// Pings that change only a box of blocks: what spreads one map over many machines.
#include <cstddef>
#include <vector>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/snapshot.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::BlockBox;
using mapperd::map::BlockKey;
using mapperd::map::PingMotion;
using mapperd::map::PingParams;
using mapperd::map::VoxelMap;

constexpr double kResolution = 0.06;

// Sound as slow as this makes a sonar's motion bend a ping by many voxels.
constexpr double kSlowSound = 100.0;

PingMotion still(scenes::Random& /*random*/) { return {}; }
PingMotion moving(scenes::Random& random) {
  return scenes::motion_of(1.9, 8.0, random, kSlowSound);
}

// A sonar whose pings cross the corner of the boxes below, and that moves within each or not.
template <typename MotionOf, typename Integrate>
VoxelMap mapped(const BlockBox& box, const MotionOf& motion_of, const Integrate& integrate) {
  scenes::Random random(501);
  scenes::Random motions(502);
  VoxelMap map(kResolution, {});
  map.limit_to(box);
  for (int i = 0; i < 4; ++i) {
    scenes::Ragged want;
    want.max_range_m = 3;
    want.beams = 96;
    want.rows = 160;
    want.surface = i % 3 == 0 ? 0.4 : 0.8;
    want.thickness = 5;
    const scenes::Ping ping = scenes::ragged_ping(want, random);
    mapperd::Transform pose = scenes::rotation_zyx(0.7 * i, 0.3, 0.1);
    pose.translation = {0.06 * i, -0.03 * i, 0.01 * i};
    integrate(map, ping, pose, motion_of(motions));
  }
  return map;
}

// Eight boxes that meet at a block which no cube of the search has its corner at.
std::vector<BlockBox> octants() {
  std::vector<BlockBox> all;
  const BlockKey middle{1, -1, 1};
  for (int octant = 0; octant < 8; ++octant) {
    BlockBox box;
    ((octant & 1) != 0 ? box.first.x : box.last.x) = middle.x + (octant & 1);
    ((octant & 2) != 0 ? box.first.y : box.last.y) = middle.y + (octant >> 1 & 1);
    ((octant & 4) != 0 ? box.first.z : box.last.z) = middle.z + (octant >> 2 & 1);
    all.push_back(box);
  }
  return all;
}

template <typename MotionOf, typename Integrate>
void check_parts_are_the_whole(const MotionOf& motion_of, const Integrate& integrate) {
  const VoxelMap whole = mapped({}, motion_of, integrate);
  CHECK(whole.known_count() > 5000);
  std::size_t blocks = 0;
  int used = 0;
  for (const BlockBox& box : octants()) {
    const VoxelMap part = mapped(box, motion_of, integrate);
    used += part.block_count() > 0 ? 1 : 0;
    CHECK(part.revision() == whole.revision());
    blocks += part.block_count();
    for (const mapperd::map::Block* block : part.sorted_blocks()) {
      CHECK(box.holds(block->key));
      const mapperd::map::Block* same = whole.find(block->key);
      CHECK((same != nullptr && same->revision == block->revision));
      for (int i = 0; same != nullptr && i < mapperd::map::kBlockVoxels; ++i) {
        const mapperd::map::Voxel a = part.voxel(*block, i);
        const mapperd::map::Voxel b = whole.voxel(*same, i);
        CHECK((a.units == b.units && a.count == b.count));
      }
    }
  }
  CHECK(used >= 3);
  CHECK(blocks == whole.block_count());
}

// Voxels of the second map that the first one has otherwise.
std::size_t differing(const VoxelMap& first, const VoxelMap& second) {
  std::size_t count = 0;
  second.for_each_known(
      [&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
        const mapperd::map::VoxelState other = first.at(voxel);
        count += other.count != state.count || other.log_odds != state.log_odds ? 1 : 0;
      });
  return count;
}

// Both kinds of sonar; that the one which moves has another map shows that it does.
template <typename Integrate>
void check_still_and_moving(const Integrate& integrate) {
  check_parts_are_the_whole(still, integrate);
  check_parts_are_the_whole(moving, integrate);
  CHECK(differing(mapped({}, still, integrate), mapped({}, moving, integrate)) > 5000);
}

TEST_CASE("maps of boxes side by side are the map of all, to the bit") {
  PingParams settings;
  settings.vertical_aperture_rad = 0.9;
  settings.carve_no_return = true;
  check_still_and_moving(
      [&](VoxelMap& map, const scenes::Ping& ping, const auto& pose, const PingMotion& motion) {
        integrate_evidence_grid(map, ping.image(), pose, settings, motion);
      });
}

TEST_CASE("sampled rays, too, change only the box") {
  check_still_and_moving(
      [](VoxelMap& map, const scenes::Ping& ping, const auto& pose, const PingMotion& motion) {
        integrate_rays(map, ping.image(), pose, {}, motion);
      });
}

TEST_CASE("a box without blocks is refused") {
  VoxelMap map(kResolution, {});
  CHECK_THROWS_AS(map.limit_to({{1, 0, 0}, {0, 0, 0}}), std::invalid_argument);
}

}  // namespace
