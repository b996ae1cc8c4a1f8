// The kernels for this machine and the plain ones give the same bits.
#include <array>
#include <cstdio>
#include <cstring>
#include <string>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/block.hpp"
#include "mapperd/map/kernels.hpp"
#include "mapperd/map/voxel_lines.hpp"

namespace {

using mapperd::map::CellPlaces;
using mapperd::map::CellTask;
using mapperd::map::Fan;
using mapperd::Vec3;
using mapperd::map::VoxelLines;

bool same_bits(double a, double b) { return std::memcmp(&a, &b, sizeof a) == 0; }

bool same_bits(const VoxelLines::Sample& a, const VoxelLines::Sample& b) {
  return same_bits(a.sum.occupied, b.sum.occupied) && same_bits(a.sum.weighted, b.sum.weighted) &&
         same_bits(a.sum.free, b.sum.free) && same_bits(a.squared, b.squared);
}

TEST_CASE("which kernels this machine runs") {
  std::printf("  %s beside %s\n", mapperd::map::kernels().name, mapperd::map::plain_kernels().name);
  CHECK(std::string(mapperd::map::plain_kernels().name) == "plain");
}

int compared_lines(std::uint64_t seed, double voxels) {
  scenes::Random random(seed);
  scenes::Ragged want;
  want.thickness = random.integer(1, 20);
  want.beams = static_cast<std::size_t>(random.integer(12, 400));
  want.nearer = 0.3;
  mapperd::map::FanSettings settings;
  settings.carve_no_return = random.uniform(0, 1) < 0.5;
  settings.min_range_m = random.uniform(0, 8);
  const scenes::Ping ping = scenes::ragged_ping(want, random);
  const double edge_m = want.max_range_m / voxels;
  const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, scenes::random_pose(random));
  const VoxelLines fast(fan, edge_m, mapperd::map::kernels());
  const VoxelLines plain(fan, edge_m, mapperd::map::plain_kernels());
  const scenes::Borders borders(ping, settings, edge_m);
  int compared = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 centre = fan.to_map(borders.point(random));
    const Fan::Verdict verdict = fan.verdict(centre, edge_m);
    if (verdict.content == Fan::Content::nothing) continue;
    const mapperd::map::Cube cube{{centre.x, centre.y, centre.z}, edge_m / 2};
    mapperd::map::LineTask task;
    if (!fast.prepare(cube, verdict.where, task)) continue;
    for (const int lines : {8, 16, 32, 64, 128}) {
      const VoxelLines::Sample a = fast.sample(task, lines);
      const VoxelLines::Sample b = plain.sample(task, lines);
      CHECK(same_bits(a, b));
      compared += a.sum.occupied + a.sum.free > 0 ? 1 : 0;
    }
  }
  return compared;
}

TEST_CASE("lines through voxels, to the bit") {
  int compared = 0;
  for (std::uint64_t scene = 0; scene < 6; ++scene) {
    compared += compared_lines(200 + scene, scene % 2 == 0 ? 40 : 160);
  }
  std::printf("  %d samples\n", compared);
  CHECK(compared > 10000);
}

TEST_CASE("places of a cell's voxels, to the bit, and where they are") {
  scenes::Random random(210);
  for (int i = 0; i < 3000; ++i) {
    const mapperd::Transform turn = scenes::random_pose(random);
    const double edge_m = random.uniform(0.02, 0.5);
    const Vec3 first{random.uniform(-30, 30), random.uniform(-30, 30), random.uniform(-30, 30)};
    const auto along = [&](const Vec3& d) {
      return mapperd::map::CellLine{mapperd::dot(d, first), {d.x * edge_m, d.y * edge_m, d.z * edge_m}};
    };
    const Vec3 low = scenes::random_pose(random).rotate({1, 0, 0});
    const Vec3 high = scenes::random_pose(random).rotate({1, 0, 0});
    const double half = random.uniform(0.01, 0.8);
    const CellTask task{along(turn.rotate({1, 0, 0})),
                        along(turn.rotate({0, 1, 0})),
                        along(turn.rotate({0, 0, 1})),
                        along(low),
                        along(high),
                        std::sin(half),
                        std::cos(half)};
    CellPlaces fast, plain;
    mapperd::map::kernels().places(task, fast);
    mapperd::map::plain_kernels().places(task, plain);
    CHECK(std::memcmp(&fast, &plain, sizeof fast) == 0);
    const int voxel = random.integer(0, mapperd::map::kCellVoxels - 1);
    const auto at = static_cast<std::size_t>(voxel);
    const Vec3 centre =
        first + edge_m * Vec3{double(voxel % 4), double(voxel / 4 % 4), double(voxel / 16)};
    const Vec3 in_sonar = turn.rotate_back(centre);
    const double horizontal = std::hypot(in_sonar.x, in_sonar.y);
    CHECK_NEAR(plain.range[at], mapperd::norm(centre), 1e-9);
    CHECK_NEAR(plain.horizontal[at], horizontal, 1e-9);
    CHECK_NEAR(plain.sine[at], -in_sonar.y / horizontal, 1e-9);
    CHECK_NEAR(plain.inside_aperture[at],
               horizontal * std::sin(half) - std::abs(in_sonar.z) * std::cos(half), 1e-9);
    CHECK_NEAR(plain.inside_sides[at],
               std::min(mapperd::dot(low, centre), mapperd::dot(high, centre)), 1e-9);
  }
}

// Any steps and limits, not only those of a rule; counts stay inside the tables.
TEST_CASE("lowered voxels, to the bit") {
  scenes::Random random(220);
  constexpr int kCounts = 100;
  std::array<std::uint32_t, kCounts> down;
  std::array<std::uint32_t, kCounts> next;
  for (int turn = 0; turn < 200; ++turn) {
    const auto any32 = [&random] { return static_cast<std::uint32_t>(random.uniform(0, 0x1p32)); };
    for (std::size_t i = 0; i < kCounts; ++i) {
      down[i] = random.integer(0, 3) == 0 ? 0xFFFFFFFFU : any32() >> random.integer(0, 31);
      next[i] = static_cast<std::uint32_t>(random.integer(0, kCounts - 1));
    }
    const auto least = -static_cast<std::int32_t>(any32() >> 1U);
    mapperd::map::DenseVoxels voxels;
    for (std::size_t i = 0; i < mapperd::map::kBlockVoxels; ++i) {
      const double above = random.integer(0, 3) == 0 ? 0.0 : random.uniform(0, 0x7FFFFFFF);
      voxels.units[i] = static_cast<std::int32_t>(least + above);
      voxels.count[i] = static_cast<std::uint16_t>(random.integer(0, kCounts - 1));
    }
    mapperd::map::VoxelRows rows;
    for (auto& row : rows) row = static_cast<std::uint16_t>(any32() & (any32() | any32()));
    const auto limit = static_cast<std::int32_t>(least + random.uniform(0, 0x7FFFFFFF));
    mapperd::map::DenseVoxels other = voxels;
    const auto run = [&](const mapperd::map::Kernels& kernels, mapperd::map::DenseVoxels& v) {
      return kernels.lower(v.units.data(), v.count.data(), rows.data(), down.data(), next.data(),
                           least, limit);
    };
    const mapperd::map::Lowered a = run(mapperd::map::kernels(), voxels);
    const mapperd::map::Lowered b = run(mapperd::map::plain_kernels(), other);
    CHECK(a.any_above == b.any_above && a.changed == b.changed);
    CHECK(std::memcmp(&voxels, &other, sizeof other) == 0);
  }
}

}  // namespace
