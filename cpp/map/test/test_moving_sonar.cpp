// Motion within the ping: the integrators against an oracle that places every sample with its own
// pose, and all that holds for a sonar at rest.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/projective.hpp"
#include "mapperd/map/rays.hpp"
#include "maps.hpp"
#include "moving_scenes.hpp"
#include "oracle_motion.hpp"

namespace {

using mapperd::map::FanSettings;
using mapperd::map::PingMotion;
using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::VoxelMap;
using oracle::Class;
using oracle::Voxel;
using scenes::Ragged;

struct Shot {
  scenes::Ping ping;
  oracle::Settings settings;
  Transform pose;
  PingMotion motion;
};

// 20 m, beams and rows about as wide as voxels. `slow` is how much slower than in water sound is:
// motion matters by as much more.
Shot shot_of(std::uint64_t seed, double slow) {
  scenes::Random random(seed);
  Ragged want;
  want.rows = 120;
  want.beams = static_cast<std::size_t>(random.integer(24, 90));
  want.thickness = random.integer(1, 6);
  want.nearer = 0.2;
  Shot shot{scenes::ragged_ping(want, random),
            {},
            scenes::random_pose(random),
            scenes::motion_of(2.0, 0.5, random, 1500.0 / slow)};
  shot.settings.resolution_m = random.uniform(0.2, 0.5);
  shot.settings.fan.vertical_aperture_rad = random.uniform(0.1, 0.3);
  shot.settings.fan.min_range_m = random.uniform(0.5, 2.0);
  shot.settings.fan.carve_no_return = random.uniform(0, 1) < 0.3;
  return shot;
}

// Voxels at the borders of classes.
std::set<Voxel> voxels_of(const Shot& shot, int count) {
  scenes::Random random(7);
  const oracle::Track track(shot.pose, shot.motion);
  const double s = shot.settings.resolution_m;
  const scenes::Borders borders(shot.ping, shot.settings.fan, s);
  std::set<Voxel> voxels;
  for (int i = 0; i < count; ++i) {
    const Vec3 v = i % 2 == 0 ? borders.point(random) : borders.corner(random);
    const Vec3 at =
        track.point({norm(v), std::atan2(-v.y, v.x), std::atan2(v.z, std::hypot(v.x, v.y))});
    const auto index = [s](double x) { return static_cast<std::int64_t>(std::floor(x / s)); };
    voxels.insert({index(at.x), index(at.y), index(at.z)});
  }
  return voxels;
}

struct Agreement {
  int occupied = 0;
  int compared = 0;
  int disputed = 0;
  double worst = 0.0;  // error in log-odds where both say occupied
  double squared = 0.0;
  double rms() const { return std::sqrt(squared / occupied); }
};

class Judge {
 public:
  Judge(const Shot& shot, int voxels) : shot_(shot) {
    const oracle::Track track(shot.pose, shot.motion);
    for (const Voxel& voxel : voxels_of(shot, voxels)) {
      parts_[voxel] = oracle::parts_of_voxel(shot.ping.image(), track, shot.settings, voxel);
    }
  }

  // A map whose maker was told of some motion.
  Agreement judge(const PingMotion& told) const {
    VoxelMap map(shot_.settings.resolution_m, shot_.settings.iwlo);
    integrate_projective(map, shot_.ping.image(), shot_.pose, shot_.settings.fan, told);
    Agreement result;
    for (const auto& [voxel, parts] : parts_) {
      if (oracle::distance_to_limit(parts) < 1e-3) continue;
      compare(map.at(mapperd::map::VoxelIndex{voxel[0], voxel[1], voxel[2]}), parts, result);
    }
    return result;
  }

 private:
  void compare(const mapperd::map::VoxelState& is, const oracle::Parts& parts, Agreement& result) const {
    oracle::State state;
    oracle::update(state, parts, shot_.settings);
    ++result.compared;
    if ((is.log_odds > 0) != (state.log_odds > 0) || (is.count == 0) != (state.count == 0)) {
      ++result.disputed;
    } else if (state.log_odds > 0) {
      ++result.occupied;
      const double error = std::abs(static_cast<double>(is.log_odds) - state.log_odds);
      result.worst = std::max(result.worst, error);
      result.squared += error * error;
    }
  }

  const Shot& shot_;
  std::map<Voxel, oracle::Parts> parts_;
};

void print(const char* name, const Agreement& a) {
  std::printf("  %s: %d voxels, %d occupied, %d disputed; log-odds off by %.1e rms, %.1e worst\n",
              name, a.compared, a.occupied, a.disputed, a.rms(), a.worst);
}

// Sound as in water, and so much slower that second orders would show.
TEST_CASE("each sample lies where its own pose puts it, in a voxel's every part") {
  for (const double slow : {0.0, 1.0, 8.0}) {
    for (std::uint64_t scene = 0; scene < (check::sanitized() ? 1 : 2); ++scene) {
      Shot shot = shot_of(800 + scene, std::max(slow, 1.0));
      if (!(slow > 0)) shot.motion = {};
      const Judge oracle(shot, check::sanitized() ? 4 : 50);
      const Agreement with = oracle.judge(shot.motion);
      print(slow > 1 ? "sound slower" : slow > 0 ? "sound as in water" : "at rest", with);
      CHECK(with.disputed == 0);
      CHECK(with.worst < 1.5e-3);
      if (check::sanitized()) continue;
      CHECK(with.occupied > 12);
      CHECK(with.rms() < 3e-4);
      if (!(slow > 0)) continue;
      const Agreement without = oracle.judge({});
      print("  without motion", without);
      CHECK(without.disputed > 0 || without.rms() > 50 * with.rms());
    }
  }
}

// Of a ping with motion, all settings.
VoxelMap mapped(const Shot& shot, const FanSettings& settings, const PingMotion& motion) {
  VoxelMap map(shot.settings.resolution_m, {});
  integrate_projective(map, shot.ping.image(), shot.pose, settings, motion);
  return map;
}

TEST_CASE("no motion is the ping as ever, to the bit, whatever else it says") {
  for (std::uint64_t scene = 0; scene < 3; ++scene) {
    Shot shot = shot_of(820 + scene, 1.0);
    for (const double bound : {0.0, 0.1}) {
      shot.settings.fan.error_bound = bound;
      VoxelMap plain(shot.settings.resolution_m, {});
      integrate_projective(plain, shot.ping.image(), shot.pose, shot.settings.fan);
      const VoxelMap still = mapped(shot, shot.settings.fan, {{}, {}, 0.03, 1480.0});
      CHECK(plain.known_count() > 1000 && encode_map(plain) == encode_map(still));
    }
  }
}

TEST_CASE("the least motion gives nearly the ping without") {
  Shot shot = shot_of(825, 1.0);
  shot.motion = {{1e-7, 0, 0}, {0, 1e-8, 0}, 0.0, 1500.0};
  const auto still = maps::content(mapped(shot, shot.settings.fan, {}));
  const VoxelMap moved = mapped(shot, shot.settings.fan, shot.motion);
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
  for (const double bound : {0.0, 0.2}) {
    Shot shot = shot_of(830, 1.0);
    shot.settings.fan.error_bound = bound;
    const VoxelMap alone = mapped(shot, shot.settings.fan, shot.motion);
    shot.settings.fan.threads = 3;
    CHECK(encode_map(alone) == encode_map(mapped(shot, shot.settings.fan, shot.motion)));
  }
}

TEST_CASE("error_bound holds for a moving sonar") {
  const double bound = 0.1;
  int occupied = 0, off = 0, others = 0;
  for (std::uint64_t scene = 0; scene < (check::sanitized() ? 1 : 3); ++scene) {
    Shot shot = shot_of(840 + scene, scene == 2 ? 5.0 : 1.0);
    shot.settings.resolution_m = 0.15;
    const VoxelMap exact = mapped(shot, shot.settings.fan, shot.motion);
    shot.settings.fan.error_bound = bound;
    const VoxelMap sampled = mapped(shot, shot.settings.fan, shot.motion);
    exact.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& a) {
      if (!(a.log_odds > 0)) return;
      const mapperd::map::VoxelState b = sampled.at(voxel);
      ++occupied;
      if (!(b.log_odds > 0)) {
        ++others;
      } else if (std::abs(a.log_odds - b.log_odds) > bound) {
        ++off;
      }
    });
  }
  std::printf("  %d occupied, %d off by more, %d of another class\n", occupied, off, others);
  CHECK(occupied > (check::sanitized() ? 100 : 5000));
  CHECK(off * 100 <= occupied && others * 100 < occupied);
}

// As in test_far.cpp: blocks of 2 m, ten thousand kilometres away, poses that lose nothing there.
TEST_CASE("far from the origin a moving sonar makes the same blocks") {
  const Vec3 far{1e7, -1e7, 1e7};
  const auto on_grid = [](double metres) { return std::nearbyint(metres * 0x1p20) * 0x1p-20; };
  for (const bool by_rays : {false, true}) {
    const Shot shot = shot_of(850, 1.0);
    std::vector<std::vector<maps::Entry>> found;
    for (const double there : {0.0, 1.0}) {
      VoxelMap map(0.125, {});
      Transform pose = shot.pose;
      Vec3& at = pose.translation;
      at = Vec3{on_grid(at.x), on_grid(at.y), on_grid(at.z)} + there * far;
      if (by_rays) {
        integrate_rays(map, shot.ping.image(), pose, {}, shot.motion);
      } else {
        integrate_projective(map, shot.ping.image(), pose, shot.settings.fan, shot.motion);
      }
      found.push_back(maps::content(map));
    }
    for (maps::Entry& entry : found[1]) {
      entry.voxel = {entry.voxel.x - 80000000, entry.voxel.y + 80000000, entry.voxel.z - 80000000};
    }
    CHECK(found[0].size() > 1000 && found[0] == found[1]);
  }
}

TEST_CASE("a pose may be given at any time of the ping") {
  const Shot shot = shot_of(860, 1.0);
  const oracle::Track track(shot.pose, shot.motion);
  const VoxelMap one = mapped(shot, shot.settings.fan, shot.motion);
  Shot later = shot;
  later.motion.valid_s = shot.motion.valid_s + 0.7;
  later.pose = track.at(later.motion.valid_s);
  const VoxelMap other = mapped(later, shot.settings.fan, later.motion);
  int differ = 0, known = 0;
  one.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& a) {
    ++known;
    if (std::abs(a.log_odds - other.at(voxel).log_odds) > 1e-4F) ++differ;
  });
  CHECK(known > 1000 && differ * 2000 < known);
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
    mapperd::map::RaysSettings settings;
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
  const Shot shot = shot_of(880, 1.0);
  VoxelMap map(0.5, {});
  const PingMotion fast{{100, 0, 0}, {}, 0.0, 1500.0};
  const PingMotion spinning{{}, {0, 60, 0}, 0.0, 1500.0};
  for (const PingMotion& motion : {fast, spinning}) {
    CHECK_THROWS(integrate_projective(map, shot.ping.image(), shot.pose, {}, motion),
                 std::invalid_argument);
    CHECK_THROWS(integrate_rays(map, shot.ping.image(), shot.pose, {}, motion),
                 std::invalid_argument);
  }
  CHECK(map.block_count() == 0);
}

}  // namespace
