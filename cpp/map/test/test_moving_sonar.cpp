// Motion within the ping: what holds for a sonar at rest holds for one that moves.
// test_evidence.cpp tests where a ping has evidence.
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/rays.hpp"
#include "maps.hpp"
#include "oracle.hpp"
#include "oracle_motion.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::PingMotion;
using mapperd::map::PingParams;
using mapperd::map::VoxelMap;
using scenes::Ragged;

struct Shot {
  scenes::Ping ping;
  oracle::Settings settings;
  Transform pose;
  PingMotion motion;
};

// 20 m, beams and rows about as wide as voxels.
Shot shot_of(std::uint64_t seed) {
  scenes::Random random(seed);
  Ragged want;
  want.rows = 120;
  want.beams = static_cast<std::size_t>(random.integer(24, 90));
  want.thickness = random.integer(1, 6);
  want.nearer = 0.2;
  Shot shot{scenes::ragged_ping(want, random),
            {},
            scenes::random_pose(random),
            scenes::motion_of(2.0, 0.5, random)};
  shot.settings.edge_m = random.uniform(0.2, 0.5);
  shot.settings.ping.vertical_aperture_rad = random.uniform(0.1, 0.3);
  shot.settings.ping.min_range_m = random.uniform(0.5, 2.0);
  shot.settings.ping.carve_no_return = random.uniform(0, 1) < 0.3;
  return shot;
}

// Of a ping with motion, all settings.
VoxelMap mapped(const Shot& shot, const PingParams& settings, const PingMotion& motion) {
  VoxelMap map(shot.settings.edge_m, {});
  integrate_evidence_grid(map, shot.ping.image(), shot.pose, settings, motion);
  return map;
}

TEST_CASE("zero motion leaves the ping bit-exact, whatever its other fields") {
  for (std::uint64_t scene = 0; scene < 3; ++scene) {
    const Shot shot = shot_of(820 + scene);
    const VoxelMap plain = mapped(shot, shot.settings.ping, {});
    const VoxelMap still = mapped(shot, shot.settings.ping, {{}, {}, 0.03, 1480.0});
    CHECK((plain.known_count() > 1000 && encode_map(plain) == encode_map(still)));
  }
}

TEST_CASE("the least motion gives nearly the ping without") {
  Shot shot = shot_of(825);
  shot.motion = {{1e-7, 0, 0}, {0, 1e-8, 0}, 0.0, 1500.0};
  const auto still = maps::content(mapped(shot, shot.settings.ping, {}));
  const VoxelMap moved = mapped(shot, shot.settings.ping, shot.motion);
  int others = 0;
  double worst = 0;
  for (const maps::Entry& entry : still) {
    const mapperd::map::VoxelState state = moved.at(entry.voxel);
    if (state.count == 0) ++others;
    if (state.count == 0 || (state.log_odds > 0) != (entry.state.log_odds > 0)) continue;
    worst = std::max(worst, static_cast<double>(std::abs(state.log_odds - entry.state.log_odds)));
  }
  CHECK(worst < 1e-4);
  CHECK(others * 1000 < static_cast<int>(still.size()));
}

TEST_CASE("of a moving sonar as well threads make no difference, to the bit") {
  Shot shot = shot_of(830);
  const VoxelMap alone = mapped(shot, shot.settings.ping, shot.motion);
  shot.settings.ping.threads = 3;
  CHECK(encode_map(alone) == encode_map(mapped(shot, shot.settings.ping, shot.motion)));
}

// As in test_far.cpp: blocks of 2 m, ten thousand kilometres away, poses that lose nothing there.
TEST_CASE("far from the origin a moving sonar makes the same blocks") {
  const Vec3 far{1e7, -1e7, 1e7};
  const auto on_grid = [](double metres) { return std::nearbyint(metres * 0x1p20) * 0x1p-20; };
  for (const bool by_rays : {false, true}) {
    const Shot shot = shot_of(850);
    std::vector<std::vector<maps::Entry>> found;
    for (const double there : {0.0, 1.0}) {
      VoxelMap map(0.125, {});
      Transform pose = shot.pose;
      Vec3& at = pose.translation;
      at = Vec3{on_grid(at.x), on_grid(at.y), on_grid(at.z)} + there * far;
      if (by_rays) {
        integrate_rays(map, shot.ping.image(), pose, {}, shot.motion);
      } else {
        integrate_evidence_grid(map, shot.ping.image(), pose, shot.settings.ping, shot.motion);
      }
      found.push_back(maps::content(map));
    }
    for (maps::Entry& entry : found[1]) {
      entry.voxel = {entry.voxel.x - 80000000, entry.voxel.y + 80000000, entry.voxel.z - 80000000};
    }
    CHECK((found[0].size() > 1000 && found[0] == found[1]));
  }
}

TEST_CASE("a pose may be given at any time of the ping") {
  const Shot shot = shot_of(860);
  const oracle::Track track(shot.pose, shot.motion);
  const VoxelMap one = mapped(shot, shot.settings.ping, shot.motion);
  Shot later = shot;
  later.motion.valid_s = shot.motion.valid_s + 0.7;
  later.pose = track.at(later.motion.valid_s);
  const VoxelMap other = mapped(later, shot.settings.ping, later.motion);
  int differ = 0, known = 0;
  one.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& a) {
    ++known;
    if (std::abs(a.log_odds - other.at(voxel).log_odds) > 1e-4F) ++differ;
  });
  CHECK((known > 1000 && differ * 2000 < known));
}

TEST_CASE("rays: each return lies where its row's own pose puts it") {
  scenes::Random random(870);
  for (int i = 0; i < 5; ++i) {
    scenes::Ping ping = scenes::empty_ping(100, 64, 0.6, 20.0);
    const auto row = static_cast<std::size_t>(random.integer(40, 95));
    for (std::size_t j = 0; j < 64; ++j) ping.intensity[row * 64 + j] = 145.0F;
    const Transform pose = scenes::random_pose(random);
    const PingMotion motion = scenes::motion_of(3.0, 1.5, random);
    VoxelMap map(0.02, {});
    mapperd::map::RaysParams settings;
    settings.vertical_aperture_rad = 0.01;
    integrate_rays(map, ping.image(), pose, settings, motion);
    const oracle::Track track(pose, motion);
    const double range = static_cast<double>(row) * 0.2;
    for (std::size_t j = 0; j < 64; ++j) {
      CHECK(map.at(track.point({range, ping.bearings_rad[j], 0.0})).log_odds > 0);
    }
  }
}

TEST_CASE("a motion that cannot be is refused and leaves the map alone") {
  const Shot shot = shot_of(880);
  VoxelMap map(0.5, {});
  const PingMotion fast{{100, 0, 0}, {}, 0.0, 1500.0};
  const PingMotion spinning{{}, {0, 60, 0}, 0.0, 1500.0};
  for (const PingMotion& motion : {fast, spinning}) {
    CHECK_THROWS_AS(integrate_evidence_grid(map, shot.ping.image(), shot.pose, {}, motion),
                    std::invalid_argument);
    CHECK_THROWS_AS(integrate_rays(map, shot.ping.image(), shot.pose, {}, motion),
                    std::invalid_argument);
  }
  CHECK(map.block_count() == 0);
}

}  // namespace
