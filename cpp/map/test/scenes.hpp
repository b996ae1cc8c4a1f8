// Seeded random pings, poses and motions.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/ping_motion.hpp"

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

// Pings over a hundred voxels and more, with ragged first returns.
struct Ragged {
  std::size_t rows = 300;
  std::size_t beams = 128;
  double half_fan_rad = 0.6;
  double surface = 0.6;     // where the first returns lie, as a part of the range ...
  double jump = 0.2;        // ... and how much neighbouring beams differ
  double silent = 0.1;      // share of the beams without a return
  int thickness = 1;        // rows after the first return, half of them with one
  double nearer = 0.0;      // share of beams with a stray return anywhere before
  double max_range_m = 20;  // of the ping
};

inline Ping ragged_ping(const Ragged& want, Random& random) {
  Ping ping = empty_ping(want.rows, want.beams, want.half_fan_rad, want.max_range_m);
  const auto rows = static_cast<double>(want.rows);
  const auto mark = [&](double row, std::size_t beam) {
    if (row < 0 || row >= rows) return;
    const auto k = static_cast<std::size_t>(row);
    ping.intensity[k * want.beams + beam] = static_cast<float>(random.uniform(36, 255));
  };
  const double phase = random.uniform(0, 6);
  for (std::size_t j = 0; j < want.beams; ++j) {
    if (random.uniform(0, 1) < want.silent) continue;
    const double slope =
        0.1 * std::sin(phase + 9.0 * static_cast<double>(j) / static_cast<double>(want.beams));
    // Speckle: most beams stay near the surface, some begin much earlier or later.
    const double spread = want.jump * random.uniform(-1, 1) * random.uniform(0, 1);
    const double first = rows * (want.surface + slope + spread);
    mark(first, j);
    for (int k = 1; k < want.thickness; ++k) {
      if (random.uniform(0, 1) < 0.5) mark(first + k, j);
    }
    if (random.uniform(0, 1) < want.nearer) mark(random.uniform(0, first), j);
  }
  return ping;
}

// A point near one of the places where classes change: first returns, shadows behind them, the
// aperture's cones, the fan's sides; or just anywhere in the fan.
class Borders {
 public:
  Borders(const Ping& ping, const mapperd::map::PingParams& settings, double edge_m)
      : ping_(ping),
        half_aperture_(settings.vertical_aperture_rad / 2),
        edge_m_(edge_m),
        edges_(mapperd::map::beam_edge_sines(ping.bearings_rad.data(), ping.bearings_rad.size())) {
    for (double& edge : edges_) edge = std::asin(edge);
  }

  mapperd::Vec3 point(Random& random) const {  // in the sonar's frame
    const double reach = ping_.image().max_range_m();
    const auto last = static_cast<int>(ping_.bearings_rad.size()) - 1;
    const auto beam = static_cast<std::size_t>(random.integer(0, last));
    const double first = first_return_m(beam);
    double range = reach * std::cbrt(random.uniform(0, 1));
    double bearing = random.uniform(edges_.front(), edges_.back());
    double elevation = random.uniform(-half_aperture_, half_aperture_);
    const int kind = random.integer(0, 9);
    if (kind < 3) range = first + random.uniform(-2.5, 2.5) * edge_m_;
    if (kind >= 3 && kind < 6) range = random.uniform(first, reach);
    const double voxel_rad = edge_m_ / std::max(range, edge_m_);
    if (kind < 6) bearing = edges_[beam] + random.uniform(-1.5, 1.5) * voxel_rad;
    const double beside = random.uniform(-1.5, 1.5) * voxel_rad;
    if (kind == 6 || kind == 5) elevation = std::copysign(half_aperture_, elevation) + beside;
    if (kind == 7) bearing = (elevation > 0 ? edges_.front() : edges_.back()) + beside;
    // Near the sonar, where the fan is thinner than a voxel.
    if (kind == 8) range = reach * std::pow(random.uniform(0, 1), 4);
    return mapperd::map::fan_point(range, bearing, elevation);
  }

  // Where a beam with a return ends, and its neighbour begins: voxels that both of these cut.
  mapperd::Vec3 corner(Random& random) const {
    const auto last = static_cast<int>(ping_.bearings_rad.size()) - 1;
    std::size_t beam = 0;
    do {
      beam = static_cast<std::size_t>(random.integer(0, last));
    } while (!(first_return_m(beam) < ping_.image().max_range_m()));
    const double range = first_return_m(beam) + random.uniform(-1, 1) * edge_m_;
    const double edge = edges_[beam + static_cast<std::size_t>(random.integer(0, 1))];
    const double beside = random.uniform(-0.5, 0.5) * edge_m_ / std::max(range, edge_m_);
    return mapperd::map::fan_point(range, edge + beside,
                                   random.uniform(-0.8, 0.8) * half_aperture_);
  }

 private:
  double first_return_m(std::size_t beam) const {
    for (std::size_t k = 0; k < ping_.rows; ++k) {
      if (ping_.intensity[k * ping_.bearings_rad.size() + beam] > 35) {
        return static_cast<double>(k) * ping_.range_resolution_m;
      }
    }
    return ping_.image().max_range_m();
  }

  const Ping& ping_;
  double half_aperture_;
  double edge_m_;
  std::vector<double> edges_;
};

inline mapperd::Vec3 random_direction(Random& random) {
  const double z = random.uniform(-1, 1);
  const double around = random.uniform(-3.14159, 3.14159);
  const double flat = std::sqrt(1 - z * z);
  return {flat * std::cos(around), flat * std::sin(around), z};
}

// Of a given speed and rate, in any direction; a slow speed of sound increases the effect.
inline mapperd::map::PingMotion motion_of(double speed_mps, double rate_radps, Random& random,
                                          double speed_of_sound_mps = 1500.0) {
  return {speed_mps * random_direction(random), rate_radps * random_direction(random),
          random.uniform(-0.05, 0.05), speed_of_sound_mps};
}

}  // namespace scenes
