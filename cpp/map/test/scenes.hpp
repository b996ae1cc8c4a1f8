// Seeded random pings and poses.
#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "mapperd/map/fan.hpp"
#include "mapperd/common/vec.hpp"

namespace scenes {

// Own distributions: those of the standard library differ between implementations.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_() >> 11U) * 0x1.0p-53;
  }
  int integer(int low, int high) { return static_cast<int>(std::floor(uniform(low, high + 1.0))); }

 private:
  std::mt19937_64 engine_;
};

inline mapperd::Transform rotation_zyx(double yaw, double pitch, double roll) {
  const double cy = std::cos(yaw), sy = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  const double cr = std::cos(roll), sr = std::sin(roll);
  mapperd::Transform t;
  t.rows = {mapperd::Vec3{cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr},
            mapperd::Vec3{sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr},
            mapperd::Vec3{-sp, cp * sr, cp * cr}};
  return t;
}

struct Ping {
  std::vector<float> intensity;
  std::vector<double> bearings_rad;
  std::size_t rows = 0;
  double range_resolution_m = 0.0;

  mapperd::map::PingImage image() const {
    return {intensity.data(), rows, bearings_rad.size(), bearings_rad.data(), range_resolution_m};
  }
};

inline Ping empty_ping(std::size_t rows, std::size_t beams, double half_aperture_rad,
                       double max_range_m) {
  Ping ping;
  ping.rows = rows;
  ping.range_resolution_m = max_range_m / static_cast<double>(rows);
  for (std::size_t j = 0; j < beams; ++j) {
    const double position = 2.0 * static_cast<double>(j) / static_cast<double>(beams - 1) - 1.0;
    ping.bearings_rad.push_back(std::asin(std::sin(half_aperture_rad) * position));
  }
  ping.intensity.assign(rows * beams, 0.0F);
  return ping;
}

// A wandering surface with speckle, thick and thin echoes, gaps, silent beams, and stray pixels.
inline Ping random_ping(Random& random) {
  const auto rows = static_cast<std::size_t>(random.integer(40, 140));
  const auto beams = static_cast<std::size_t>(random.integer(16, 90));
  Ping ping = empty_ping(rows, beams, random.uniform(0.3, 1.13), random.uniform(1.5, 4.0));
  double surface = random.uniform(0.3, 0.8) * static_cast<double>(rows);
  const double wander = random.uniform(0.2, 4.0);
  for (std::size_t j = 0; j < beams; ++j) {
    surface += random.uniform(-wander, wander);
    surface = std::min(std::max(surface, 5.0), static_cast<double>(rows));
    const bool silent = random.uniform(0, 1) < 0.1;
    const int thickness = random.integer(1, 12);
    for (int k = 0; k < thickness && !silent; ++k) {
      const auto row = static_cast<std::size_t>(surface) + static_cast<std::size_t>(k);
      if (row >= rows || random.uniform(0, 1) < 0.15) continue;
      ping.intensity[row * beams + j] = static_cast<float>(random.uniform(0, 255));
    }
    if (random.uniform(0, 1) < 0.1) {
      const auto row = static_cast<std::size_t>(random.uniform(0, static_cast<double>(rows)));
      ping.intensity[row * beams + j] = static_cast<float>(random.uniform(36, 255));
    }
  }
  return ping;
}

inline mapperd::Transform random_pose(Random& random) {
  mapperd::Transform pose =
      rotation_zyx(random.uniform(-3.1, 3.1), random.uniform(-1.5, 1.5), random.uniform(-3.1, 3.1));
  pose.translation = {random.uniform(-50, 50), random.uniform(-50, 50), random.uniform(-20, 0)};
  return pose;
}

}  // namespace scenes
