// Maps of made-up pings, down to the last bit on every machine: their checksums stand below.
//
// Where they change, maps of recordings change too: that is a new version of the rule, of the grid
// or of the file, and is listed in the changelog.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

#include "mapperd/map/bytes.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::PingMotion;
using mapperd::map::PingParams;
using mapperd::map::VoxelMap;

// A linear congruential generator (Knuth's MMIX): whole numbers alone.
class Numbers {
 public:
  explicit Numbers(std::uint64_t seed) : state_(seed) {}
  int below(int end) {
    state_ = state_ * 6364136223846793005U + 1442695040888963407U;
    return static_cast<int>((state_ >> 33U) % static_cast<std::uint64_t>(end));
  }

 private:
  std::uint64_t state_;
};

struct Scene {
  std::vector<float> intensity;
  std::vector<double> bearings;
  std::size_t rows;
  double row_m;

  mapperd::map::PingImage image() const {
    return {intensity.data(), rows, bearings.size(), bearings.data(), row_m};
  }
};

// A surface that wanders, with speckle; bearings that are multiples of 2^-10.
Scene scene_of(int seed) {
  Numbers numbers(static_cast<std::uint64_t>(seed));
  Scene scene;
  const int beams = 24 + 17 * (seed % 4);
  scene.rows = 150;
  scene.row_m = 0.03125;
  for (int j = 0; j < beams; ++j) {
    const int even = (2 * j + 1 - beams) * 900 / beams;
    scene.bearings.push_back((even + (seed % 3 == 2 ? numbers.below(5) : 0)) / 1024.0);
  }
  scene.intensity.assign(scene.rows * scene.bearings.size(), 0.0F);
  int surface = 60 + numbers.below(60);
  for (int j = 0; j < beams; ++j) {
    surface += numbers.below(7) - 3;
    for (int k = 0; k < 8; ++k) {
      const int row = surface + k - (numbers.below(20) == 0 ? 30 : 0);
      if (row < 0 || row >= 150 || numbers.below(4) == 0) continue;
      scene.intensity[static_cast<std::size_t>(row * beams + j)] =
          static_cast<float>(numbers.below(256));
    }
  }
  return scene;
}

// Turned by Pythagorean triples: 3-4-5 about z, 5-12-13 about y.
mapperd::Transform pose_of(int seed) {
  mapperd::Transform pose;
  const double c = seed % 2 == 0 ? 0.8 : -0.6, s = seed % 2 == 0 ? 0.6 : 0.8;
  const double cp = 12.0 / 13, sp = seed % 5 == 0 ? -5.0 / 13 : 5.0 / 13;
  pose.rows = {mapperd::Vec3{c * cp, -s, c * sp}, mapperd::Vec3{s * cp, c, s * sp},
               mapperd::Vec3{-sp, 0, cp}};
  pose.translation = {seed * 0.125, -0.375 * seed, 1.5};
  return pose;
}

std::uint32_t checksum_of(const PingParams& settings, const PingMotion& motion, double edge_m,
                          const mapperd::map::IwloParams& params) {
  VoxelMap map(edge_m, params);
  for (int seed = 0; seed < 12; ++seed) {
    const Scene scene = scene_of(seed);
    integrate_evidence_grid(map, scene.image(), pose_of(seed % 7), settings, motion);
  }
  CHECK((map.known_count() > 10000 && map.held_count() > 10000));
  const std::string file = encode_map(map);
  return mapperd::map::crc32(file.substr(0, file.size() - 4));  // it ends with its own
}

void check_golden(const char* what, std::uint32_t expected, const PingParams& settings,
                  const PingMotion& motion = {}, double edge_m = 0.0625,
                  const mapperd::map::IwloParams& params = {}) {
  const std::uint32_t found = checksum_of(settings, motion, edge_m, params);
  std::printf("  %s: 0x%08X\n", what, found);
  CHECK(found == expected);
}

TEST_CASE("golden maps, to the bit on every machine") {
  check_golden("usual settings", 0xBE51A2F9U, {});
  PingParams wide;
  wide.vertical_aperture_rad = 0.75;
  wide.carve_no_return = true;
  wide.min_range_m = 0.25;
  wide.threads = 2;
  check_golden("a wide aperture, no return carved", 0xFB896DD8U, wide);
  PingParams mean;
  mean.aggregation = mapperd::map::Aggregation::kMean;
  mean.detail = 2.0;
  check_golden("averaged, twice the detail", 0x5FE7C0C4U, mean);
  mapperd::map::IwloParams slow;
  slow.decay_rate = 0.015625;
  slow.adaptive_update = false;
  slow.L_max = 60.0;
  check_golden("counts of two bytes, wide clamps", 0x222510E4U, {}, {}, 0.09375, slow);
  check_golden("a sonar that moves", 0x7B32B74EU, {},
               {{1.5, -0.5, 0.25}, {0.25, -0.5, 1.0}, 0.015625, 1500.0});
}

}  // namespace
