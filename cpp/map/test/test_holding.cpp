// However the content of a map is held, and in whatever order it came about, it is the same to the
// bit, and stays so under what comes next.
#include <algorithm>
#include <string>
#include <vector>

#include "mapperd/map/distance_field.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/merge.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/snapshot.hpp"
#include "maps.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::VoxelMap;

constexpr double kResolution = 0.08;

struct Shot {
  scenes::Ping ping;
  Transform pose;
};

mapperd::map::PingParams wide() {
  mapperd::map::PingParams settings;
  settings.vertical_aperture_rad = 1.2;
  return settings;
}

// A wall that is near at first and moves away: blocks that it crossed come to be free throughout,
// and are counted, not opened. Some pings show another scene altogether.
std::vector<Shot> shots() {
  std::vector<Shot> all;
  scenes::Random random(31);
  for (int i = 0; i < 12; ++i) {
    scenes::Ping ping = scenes::empty_ping(40, 12, 1.0, 4.0);
    const auto row = static_cast<std::size_t>(i < 2 ? 24 : 38);
    for (std::size_t j = 0; j < 12; ++j) {
      ping.intensity[row * 12 + j] = static_cast<float>(random.uniform(40, 90));
    }
    Transform pose = scenes::rotation_zyx(0.01 * i, 0, 0);
    pose.translation = {0.64, 0.64, 0.64};  // the middle of a block: the next but one is free
    if (i % 5 == 4) {
      ping = scenes::random_ping(random);
      pose = scenes::random_pose(random);
      pose.translation = {0.3, 0.2, 0.1};
    }
    all.push_back({std::move(ping), pose});
  }
  return all;
}

void integrate(VoxelMap& map, const Shot& shot, const mapperd::map::PingParams& settings = wide()) {
  integrate_evidence_grid(map, shot.ping.image(), shot.pose, settings);
}

void open_and_close_all(VoxelMap& map) {
  for (const mapperd::map::BlockKey& key : dense_blocks(map, 0, map.block_count()).keys) {
    maps::open_and_close(map, key);
  }
}

void ask_everything(const VoxelMap& map) {
  const mapperd::map::VoxelBox box = box_of(map, {-1, -1, -1}, {3, 1, 1});
  const double ray[] = {0, 0, 0, 1, 0, 0};
  classify_box(map, box, {0.5, -0.5});
  distance_field(map, box, 0.5, 0.5);
  ray_cast_depth(map, {ray, 1}, {ray + 3, 1}, 5, 0.5);
  dense_blocks(map, 0, map.block_count());
  encode_map(map);
}

bool equal(const VoxelMap& a, const VoxelMap& b) { return encode_map(a) == encode_map(b); }

void check_pending(const mapperd::map::PingParams& settings) {
  VoxelMap pending(kResolution, {}), opened(kResolution, {}), asked(kResolution, {});
  for (const Shot& shot : shots()) {
    for (VoxelMap* map : {&pending, &opened, &asked}) integrate(*map, shot, settings);
    open_and_close_all(opened);
    ask_everything(asked);
  }
  CHECK(pending.known_count() > 20000);
  CHECK((equal(pending, opened) && equal(pending, asked)));
  const auto a = dense_blocks(pending, 0, 10000), b = dense_blocks(opened, 0, 10000);
  CHECK((a.keys == b.keys && a.units == b.units && a.counts == b.counts));
  CHECK(known_count(pending) == known_count(opened));
}

TEST_CASE("pending cells are the cells that are opened after every ping, to the bit") {
  check_pending(wide());
}

TEST_CASE("so are those of averaged evidence, written by two threads") {
  mapperd::map::PingParams settings = wide();
  settings.aggregation = mapperd::map::Aggregation::kMean;
  settings.threads = 2;
  check_pending(settings);
}

TEST_CASE("saved and loaded at any time, a map goes on as if it had not been") {
  VoxelMap straight(kResolution, {}), saved(kResolution, {});
  for (const Shot& shot : shots()) {
    integrate(straight, shot);
    integrate(saved, shot);
    VoxelMap loaded(kResolution, {});
    load_map(encode_map(saved), loaded);
    CHECK(equal(loaded, saved));
    load_map(encode_map(loaded), saved);  // back into one that has pending blocks
  }
  CHECK((equal(straight, saved) && straight.known_count() > 20000));
}

TEST_CASE("the order in which blocks come about does not show") {
  std::vector<Shot> apart;  // each in a region of its own
  for (const Shot& shot : shots()) {
    apart.push_back(shot);
    apart.back().pose.translation = {20.0 * static_cast<double>(apart.size()), 0, -3};
  }
  VoxelMap forth(kResolution, {}), back(kResolution, {});
  for (const Shot& shot : apart) integrate(forth, shot);
  std::reverse(apart.begin(), apart.end());
  for (const Shot& shot : apart) integrate(back, shot);
  CHECK((equal(forth, back) && forth.known_count() > 20000));

  const auto by_rays = [](VoxelMap& map, const Shot& shot) {
    integrate_rays(map, shot.ping.image(), shot.pose, {});
  };
  VoxelMap rays_forth(kResolution, {}), rays_back(kResolution, {});
  for (auto shot = apart.begin(); shot != apart.end(); ++shot) by_rays(rays_forth, *shot);
  for (auto shot = apart.rbegin(); shot != apart.rend(); ++shot) by_rays(rays_back, *shot);
  CHECK((equal(rays_forth, rays_back) && rays_forth.known_count() > 1000));
}

TEST_CASE("merged in any order, pending or opened, the sum is the same") {
  const std::vector<Shot> all = shots();
  std::vector<VoxelMap> parts;
  for (std::size_t part = 0; part < 3; ++part) {
    parts.emplace_back(kResolution, mapperd::map::IwloParams{});
    for (std::size_t i = part; i < all.size(); i += 3) integrate(parts.back(), all[i]);
  }
  VoxelMap first(kResolution, {});
  merge(first, {&parts[0], &parts[1], &parts[2]});
  VoxelMap second(kResolution, {});
  merge(second, {&parts[2], &parts[0], &parts[1]});
  for (VoxelMap& part : parts) open_and_close_all(part);
  VoxelMap third(kResolution, {});
  merge(third, {&parts[1], &parts[2], &parts[0]});
  CHECK((equal(first, second) && equal(first, third) && first.known_count() > 20000));
}

}  // namespace
