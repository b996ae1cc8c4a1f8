// The projective integrator against the converged oracle.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <map>
#include <set>
#include <stdexcept>

#include "check.hpp"
#include "mapperd/map/projective.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/voxel_integral.hpp"
#include "oracle.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::VoxelMap;
using oracle::Class;
using oracle::Voxel;

struct Agreement {
  std::size_t voxels = 0;
  std::size_t disputed = 0;
  double worst_log_odds = 0.0;
};

std::set<Voxel> known_voxels(const VoxelMap& map) {
  std::set<Voxel> known;
  map.for_each_known([&known](const mapperd::map::VoxelIndex& v, const mapperd::map::VoxelState&) {
    known.insert({v.x, v.y, v.z});
  });
  return known;
}

mapperd::Vec3 centre_of(const Voxel& v, double s) {
  const auto at = [s](std::int64_t i) { return (static_cast<double>(i) + 0.5) * s; };
  return {at(v[0]), at(v[1]), at(v[2])};
}

// Integrates several pings into both, and compares after each.
class Comparison {
 public:
  explicit Comparison(const oracle::Settings& settings)
      : settings_(settings), map_(settings.resolution_m, settings.iwlo) {}

  void ping(const mapperd::map::PingImage& image, const mapperd::Transform& pose) {
    const auto before = counts();
    mapperd::map::integrate_projective(map_, image, pose, settings_.fan);
    const auto parts = oracle::parts_of_ping(image, pose, settings_);
    std::set<Voxel> touched = known_voxels(map_);
    for (const auto& [voxel, part] : parts) touched.insert(voxel);
    for (const Voxel& voxel : touched) {
      const auto found = parts.find(voxel);
      compare(voxel, found == parts.end() ? oracle::Parts{} : found->second, before);
    }
  }

  Agreement result;

 private:
  std::map<Voxel, mapperd::map::VoxelState> counts() const {
    std::map<Voxel, mapperd::map::VoxelState> states;
    for (const Voxel& v : known_voxels(map_)) {
      states[v] = map_.at(centre_of(v, settings_.resolution_m));
    }
    return states;
  }

  void compare(const Voxel& voxel, const oracle::Parts& part,
               const std::map<Voxel, mapperd::map::VoxelState>& before) {
    const auto found = before.find(voxel);
    const mapperd::map::VoxelState was = found == before.end() ? mapperd::map::VoxelState{} : found->second;
    const mapperd::map::VoxelState is = map_.at(centre_of(voxel, settings_.resolution_m));
    Class ours = Class::untouched;
    // Neither clamp is reached in these few pings, so every update moves the log-odds.
    if (is.log_odds > was.log_odds) ours = Class::occupied;
    if (is.log_odds < was.log_odds) ours = Class::free;
    const Class theirs = oracle::class_of(part);
    if (ours == Class::untouched && theirs == Class::untouched) return;
    ++result.voxels;
    // A mean of both kinds may go either way: there the log-odds alone tell the parts apart.
    const bool is_mean = settings_.fan.aggregation == mapperd::map::Aggregation::mean;
    if (is_mean && ours != Class::untouched && theirs != Class::untouched) ours = theirs;
    if (ours != theirs) {
      ++result.disputed;
      excluded_.insert(voxel);
      CHECK(oracle::distance_to_limit(part) <= 0.01);
    }
    oracle::State& state = states_[voxel];
    oracle::update(state, part, settings_);
    if (excluded_.count(voxel) != 0) return;
    const double error = std::abs(static_cast<double>(is.log_odds) - state.log_odds);
    if (error > 1e-4 && std::getenv("ORACLE_VERBOSE") != nullptr) {
      std::printf("  off by %.2e: occupied %.5f free %.5f weight %.5f\n", error, part.occupied,
                  part.free, part.weight());
    }
    result.worst_log_odds = std::max(result.worst_log_odds, error);
    CHECK(error <= 1e-4);
  }

  oracle::Settings settings_;
  VoxelMap map_;
  std::map<Voxel, oracle::State> states_;
  std::set<Voxel> excluded_;
};

// Sanitizer builds are some twenty times slower: a few scenes do there.
int scene_count() {
  const char* count = std::getenv("MAPPERD_ORACLE_SCENES");
  return count == nullptr ? 24 : std::atoi(count);
}

oracle::Settings random_settings(scenes::Random& random, double max_range_m) {
  oracle::Settings settings;
  // Few voxels along a ray: the oracle's time grows with the fourth power of their number.
  settings.resolution_m = max_range_m / random.uniform(6, 11);
  settings.fan.vertical_aperture_rad = random.uniform(0.2, 0.45);
  settings.fan.min_range_m = random.uniform(0, 1) < 0.2 ? 0.0 : random.uniform(0.1, 0.7);
  settings.fan.carve_no_return = random.uniform(0, 1) < 0.3;
  settings.iwlo.sharpness = random.uniform(0.1, 5.0);
  return settings;
}

mapperd::Transform pose_of_scene(int scene, scenes::Random& random) {
  mapperd::Transform pose = scenes::random_pose(random);
  // Level and straight down, on a voxel's corner: where faces and bearings coincide.
  if (scene == 0) pose = mapperd::Transform{};
  if (scene == 1) pose = scenes::rotation_zyx(0, 1.5707963267948966, 0);
  return pose;
}

TEST_CASE("projective equals the oracle on random scenes and poses") {
  Agreement total;
  for (int scene = 0; scene < scene_count(); ++scene) {
    scenes::Random random(1000 + static_cast<std::uint64_t>(scene));
    const scenes::Ping first = scenes::random_ping(random);
    oracle::Settings settings = random_settings(random, first.image().max_range_m());
    if (scene % 6 == 5) settings.fan.aggregation = mapperd::map::Aggregation::mean;
    if (scene % 4 == 3) settings.iwlo.adaptive_min_ratio = 0;  // the published rule
    Comparison comparison(settings);
    mapperd::Transform pose = pose_of_scene(scene, random);
    comparison.ping(first.image(), pose);
    // The same ping from elsewhere meets voxels that already hold something.
    pose.translation.x += 0.37;
    comparison.ping(first.image(), pose);
    const Agreement& a = comparison.result;
    std::printf("  scene %2d: %6zu voxels, %3zu in dispute, worst log-odds error %.1e\n", scene,
                a.voxels, a.disputed, a.worst_log_odds);
    total.voxels += a.voxels;
    total.disputed += a.disputed;
    total.worst_log_odds = std::max(total.worst_log_odds, a.worst_log_odds);
  }
  const double share = static_cast<double>(total.disputed) / static_cast<double>(total.voxels);
  std::printf("  share of voxels in dispute: %.4f %% of %zu; worst log-odds error %.1e\n",
              100 * share, total.voxels, total.worst_log_odds);
  CHECK(share < 0.005);
}

struct Totals {
  double occupied = 0.0;
  double free = 0.0;
};

// The parts of all voxels together, in cubic metres.
Totals total_volume(const scenes::Ping& ping, const mapperd::map::FanSettings& settings,
                    const mapperd::Transform& pose, double s) {
  const mapperd::map::IwloRule rule{mapperd::map::IwloParams{}};
  const mapperd::map::PingImage image = ping.image();
  const mapperd::map::Fan fan(image, settings, rule, pose);
  const int reach = static_cast<int>(image.max_range_m() / s) + 2;
  Totals totals;
  for (int x = -reach; x < reach; ++x) {
    for (int y = -reach; y < reach; ++y) {
      for (int z = -reach; z < reach; ++z) {
        // The sonar somewhere inside a voxel.
        const mapperd::Vec3 centre{(x + 0.3) * s, (y + 0.6) * s, (z + 0.45) * s};
        const mapperd::map::Fan::Verdict verdict = fan.verdict(centre, s);
        if (verdict.content == mapperd::map::Fan::Content::nothing) continue;
        mapperd::map::FanPart where = verdict.where;
        if (verdict.content == mapperd::map::Fan::Content::all_free) {
          totals.free += s * s * s;
          continue;
        }
        const mapperd::map::Cube cube{{centre.x, centre.y, centre.z}, s / 2};
        totals.occupied += mapperd::map::occupied_part(fan, cube, where).part * s * s * s;
        totals.free += mapperd::map::free_part(fan, cube, where) * s * s * s;
      }
    }
  }
  return totals;
}

TEST_CASE("the parts of all voxels add up to the volume of the fan") {
  scenes::Random random(7);
  for (int i = 0; i < 6; ++i) {
    scenes::Ping ping = scenes::empty_ping(50, 40, random.uniform(0.3, 1.2), 3.0);
    for (std::size_t j = 0; j < 40; ++j) {
      for (std::size_t k = 30; k < 34; ++k) ping.intensity[k * 40 + j] = 200.0F;
    }
    mapperd::map::FanSettings settings;
    settings.min_range_m = i == 0 ? 0.0 : 0.4;
    const auto edges = mapperd::map::beam_edges(ping.bearings_rad.data(), 40);
    const double solid_angle =
        (edges.back() - edges.front()) * 2 * std::sin(settings.vertical_aperture_rad / 2);
    const auto shell = [&](double near_m, double far_m) {
      return solid_angle * (std::pow(far_m, 3) - std::pow(near_m, 3)) / 3;
    };
    const mapperd::Transform pose = i == 1 ? mapperd::Transform{} : scenes::random_pose(random);
    const Totals totals = total_volume(ping, settings, pose, 0.17);
    CHECK_NEAR(totals.occupied / shell(1.8, 2.04), 1.0, 1e-6);
    CHECK_NEAR(totals.free / shell(settings.min_range_m, 1.8), 1.0, 1e-6);
  }
}

// A voxel on its own: all beams, the whole range, and no verdict beforehand.
Class class_on_its_own(const mapperd::map::Fan& fan, const mapperd::Vec3& centre, double s) {
  const mapperd::map::FanPart everywhere{0, fan.beams() - 1, 0.0, fan.max_range_m(), true};
  const mapperd::map::Cube cube{{centre.x, centre.y, centre.z}, s / 2};
  const double occupied = mapperd::map::occupied_part(fan, cube, everywhere).part;
  const double free = mapperd::map::free_part(fan, cube, everywhere);
  const oracle::Parts parts{occupied, free, 0.0};
  // Rounding decides there; the walk may have settled it by symmetry.
  if (oracle::distance_to_limit(parts) < 1e-4) return Class::untouched;
  return oracle::class_of(parts);
}

// Somewhere in the fan or a little beside it, half of the time at the aperture's edge.
mapperd::Vec3 random_point(scenes::Random& random, const scenes::Ping& ping, double half_aperture) {
  const double margin = 0.05;
  // Often near the sonar, where the fan is thinner than a voxel.
  const double part = random.uniform(0, 1.02);
  const double range = ping.image().max_range_m() * part * part;
  const double bearing =
      random.uniform(ping.bearings_rad.front() - margin, ping.bearings_rad.back() + margin);
  double elevation = random.uniform(-half_aperture - margin, half_aperture + margin);
  if (random.uniform(0, 1) < 0.5) {
    elevation = std::copysign(half_aperture, elevation) + random.uniform(-margin, margin);
  }
  return mapperd::map::fan_point(range, bearing, elevation);
}

// Open water up to a wall at nine tenths of the range.
scenes::Ping distant_wall(scenes::Random& random) {
  const auto beams = static_cast<std::size_t>(random.integer(30, 128));
  scenes::Ping ping = scenes::empty_ping(100, beams, random.uniform(0.3, 1.1), 10.0);
  for (std::size_t j = 0; j < beams; ++j) {
    for (std::size_t k = 90; k < 92; ++k) {
      ping.intensity[k * beams + j] = static_cast<float>(random.uniform(40, 255));
    }
  }
  return ping;
}

std::size_t wrong_voxels(scenes::Random& random, const scenes::Ping& ping,
                         const mapperd::map::FanSettings& settings, double s) {
  VoxelMap map(s, {});
  const mapperd::Transform pose = scenes::random_pose(random);
  mapperd::map::integrate_projective(map, ping.image(), pose, settings);
  const mapperd::map::Fan fan(ping.image(), settings, map.rule(), pose);
  std::size_t wrong = 0;
  for (int i = 0; i < 1500; ++i) {
    const mapperd::Vec3 point =
        pose.apply(random_point(random, ping, settings.vertical_aperture_rad / 2));
    const auto index = [s](double at) { return static_cast<std::int64_t>(std::floor(at / s)); };
    const mapperd::Vec3 centre = centre_of({index(point.x), index(point.y), index(point.z)}, s);
    const Class expected = class_on_its_own(fan, centre - pose.translation, s);
    const float log_odds = map.at(centre).log_odds;
    if (expected == Class::occupied && !(log_odds > 0)) ++wrong;
    if (expected == Class::free && !(log_odds < 0)) ++wrong;
  }
  return wrong;
}

TEST_CASE("the walk from large cubes to voxels gives what each voxel gives on its own") {
  // A hundred voxels and more along a ray: whole blocks fit between the fan's boundaries, and
  // settling them at once must not settle a voxel wrongly. The oracle's scenes are too small.
  scenes::Random random(31);
  for (int scene = 0; scene < (check::sanitized() ? 4 : 8); ++scene) {
    const scenes::Ping ping = scene % 2 == 0 ? distant_wall(random) : scenes::random_ping(random);
    mapperd::map::FanSettings settings;
    settings.vertical_aperture_rad = random.uniform(0.1, 0.6);
    settings.carve_no_return = scene % 4 < 2;
    settings.min_range_m = 0.02;
    const double s = ping.image().max_range_m() / random.uniform(60, 150);
    CHECK(wrong_voxels(random, ping, settings, s) == 0);
  }
}

TEST_CASE("a bad ping or pose is refused and leaves the map alone") {
  const double not_a_number = std::numeric_limits<double>::quiet_NaN();
  VoxelMap map(0.1, {});
  scenes::Ping ping = scenes::empty_ping(10, 8, 0.5, 2.0);
  ping.intensity.assign(80, 200.0F);
  const auto refuses = [&](const scenes::Ping& p, const mapperd::Transform& pose) {
    CHECK_THROWS(mapperd::map::integrate_projective(map, p.image(), pose, {}), std::logic_error);
    CHECK(map.block_count() == 0);
  };
  mapperd::Transform pose;
  pose.translation.y = not_a_number;
  refuses(ping, pose);
  pose.translation.y = 1e12;
  refuses(ping, pose);
  pose = {};
  pose.rows[1].y = 2.0;
  refuses(ping, pose);
  pose.rows[1].y = not_a_number;
  refuses(ping, pose);
  scenes::Ping bad = ping;
  bad.bearings_rad[3] = bad.bearings_rad[2];
  refuses(bad, {});
  bad = ping;
  bad.bearings_rad[0] = not_a_number;
  refuses(bad, {});
  bad = ping;
  bad.range_resolution_m = not_a_number;
  refuses(bad, {});
  bad.range_resolution_m = -0.1;
  refuses(bad, {});
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
  for (int i = 0; i < 5; ++i) mapperd::map::integrate_projective(map, ping.image(), {}, {});
  CHECK(map.block_count() > 0);
  map.for_each_known([](const mapperd::map::VoxelIndex&, const mapperd::map::VoxelState& state) {
    CHECK(std::abs(state.log_odds) <= 10.0F);
  });
}

TEST_CASE("a pose that is no rotation is refused: skewed, mirrored") {
  VoxelMap map(0.1, {});
  scenes::Ping ping = scenes::empty_ping(10, 8, 0.5, 2.0);
  ping.intensity.assign(80, 200.0F);
  mapperd::Transform skewed;
  skewed.rows[1] = skewed.rows[0];
  mapperd::Transform mirrored;
  mirrored.rows[2].z = -1.0;
  for (const mapperd::Transform& pose : {skewed, mirrored}) {
    CHECK_THROWS(mapperd::map::integrate_projective(map, ping.image(), pose, {}), std::logic_error);
    CHECK_THROWS(mapperd::map::integrate_rays(map, ping.image(), pose, {}), std::logic_error);
  }
  CHECK(map.block_count() == 0);
}

TEST_CASE("what is settled does not change any more, nor does its revision") {
  scenes::Random random(91);
  const scenes::Ping ping = scenes::empty_ping(40, 32, 0.6, 4.0);
  mapperd::map::FanSettings settings;
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
  for (int i = 0; i < 100; ++i) {
    mapperd::map::integrate_projective(map, ping.image(), pose, settings);
  }
  CHECK(last_change() > 80);  // counts settle after 90 pings
  const std::uint64_t settled = last_change();
  CHECK(settled < map.revision());
  for (int i = 0; i < 5; ++i) {
    mapperd::map::integrate_projective(map, ping.image(), pose, settings);
    CHECK(last_change() == settled);
  }
}

TEST_CASE("looking at nothing creates no block") {
  VoxelMap map(0.1, {});
  const scenes::Ping ping = scenes::empty_ping(20, 16, 0.5, 2.0);
  const mapperd::map::PingStats stats = mapperd::map::integrate_projective(map, ping.image(), {}, {});
  CHECK(map.block_count() == 0);
  CHECK(stats.free == 0);
  mapperd::map::FanSettings carve;
  carve.carve_no_return = true;
  CHECK(mapperd::map::integrate_projective(map, ping.image(), {}, carve).free > 100);
}

}  // namespace
