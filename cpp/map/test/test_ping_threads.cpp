// The map does not depend on how many threads look and write.
#include <cstdint>
#include <vector>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/snapshot.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::Aggregation;
using mapperd::map::PingParams;
using mapperd::map::VoxelMap;

constexpr double kResolution = 0.06;

struct Shot {
  scenes::Ping ping;
  mapperd::Transform pose;
};

// A sonar that moves, and turns so far that blocks seen free come to hold returns and the reverse.
std::vector<Shot> moving_pings() {
  scenes::Random random(500);
  std::vector<Shot> all;
  for (int i = 0; i < 4; ++i) {
    scenes::Ragged want;
    want.max_range_m = 3;
    want.beams = 96;
    want.rows = 160;
    want.surface = i % 3 == 0 ? 0.4 : 0.8;
    want.thickness = 5;
    Shot shot{scenes::ragged_ping(want, random), scenes::rotation_zyx(0.05 * i, 0.3, 0.1)};
    shot.pose.translation = {0.06 * i, -0.03 * i, 0.01 * i};
    all.push_back(std::move(shot));
  }
  return all;
}

VoxelMap mapped(const std::vector<Shot>& shots, const PingParams& settings) {
  VoxelMap map(kResolution, {});
  for (const Shot& shot : shots) {
    integrate_evidence_grid(map, shot.ping.image(), shot.pose, settings);
  }
  return map;
}

std::vector<std::uint64_t> revisions(const VoxelMap& map) {
  std::vector<std::uint64_t> all;
  for (const mapperd::map::Block* block : map.sorted_blocks()) all.push_back(block->revision);
  return all;
}

void check_equal(const VoxelMap& a, const VoxelMap& b) {
  const auto one = dense_blocks(a, 0, a.block_count());
  const auto other = dense_blocks(b, 0, b.block_count());
  CHECK((one.keys == other.keys && one.units == other.units && one.counts == other.counts));
  CHECK((revisions(a) == revisions(b) && a.revision() == b.revision()));
}

std::vector<PingParams> all_settings() {
  std::vector<PingParams> all(3);
  all[1].aggregation = Aggregation::kMean;
  all[2].detail = 2.0;
  all[2].carve_no_return = true;
  for (PingParams& settings : all) settings.vertical_aperture_rad = 0.9;
  return all;
}

TEST_CASE("one, two, three or five threads make the same map, to the bit") {
  const std::vector<Shot> shots = moving_pings();
  for (PingParams settings : all_settings()) {
    const VoxelMap alone = mapped(shots, settings);
    CHECK(alone.known_count() > 10000);
    for (const int threads : {2, 3, 5}) {
      if (kSanitized && threads != 3) continue;  // the same ways
      settings.threads = threads;
      const VoxelMap shared = mapped(shots, settings);
      check_equal(alone, shared);
      CHECK(encode_map(alone) == encode_map(shared));
    }
  }
}

}  // namespace
