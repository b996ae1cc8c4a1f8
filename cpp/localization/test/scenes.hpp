// Maps and clouds of the particle filter's tests.
#pragma once

#include <cmath>
#include <cstdint>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/gaussian.hpp"
#include "mapperd/localization/particle_filter.hpp"

namespace scenes {

using namespace mapperd;
using namespace mapperd::localization;

inline OccupancyGrid open_water(std::size_t rows, std::size_t columns, double resolution_m) {
  return {{rows, columns, resolution_m, {}}, std::vector<std::int8_t>(rows * columns, kFree)};
}

// A walled basin with piles, and unknown ground in a corner.
inline OccupancyGrid basin() {
  OccupancyGrid grid = open_water(120, 160, 0.25);
  grid.frame.origin = {-20.0, -15.0, 0.0};
  for (std::size_t r = 0; r < 120; ++r) {
    for (std::size_t c = 0; c < 160; ++c) {
      const bool wall = r < 3 || r > 116 || c < 3 || c > 156;
      const bool pile = r % 37 < 3 && c % 29 < 3;
      if (wall || pile) grid.cells[r * 160 + c] = kOccupied;
      if (r > 110 && c > 150) grid.cells[r * 160 + c] = kUnknown;
    }
  }
  return grid;
}

inline OccupancyGrid scattered(std::size_t rows, std::size_t columns, std::uint64_t seed,
                               double share) {
  OccupancyGrid grid = open_water(rows, columns, 0.5);
  for (std::size_t i = 0; i < grid.cells.size(); ++i) {
    const Words words = philox({{static_cast<std::uint32_t>(i), 0, 0, 0}}, seed);
    if (uniform_of(words.word[0]) < share) grid.cells[i] = kOccupied;
  }
  return grid;
}

// What beams from a pose see of the map: ends in the base frame.
inline Endpoints seen_from(const RangeMap& map, const Pose2& pose, std::size_t beams,
                           double max_range_m) {
  Endpoints ends;
  for (std::size_t j = 0; j < beams; ++j) {
    const double bearing = -1.1 + 2.2 * static_cast<double>(j) / static_cast<double>(beams);
    const double range = map.cast({pose.x, pose.y, wrapped(pose.yaw + bearing)}, max_range_m);
    if (range < 0.0 || range >= max_range_m) continue;
    ends.x_m.push_back(range * std::cos(bearing));
    ends.y_m.push_back(range * std::sin(bearing));
    ends.quality.push_back(1.0);
  }
  return ends;
}

inline Beams beams_of(const Endpoints& ends) {
  Beams beams;
  for (std::size_t j = 0; j < ends.beams(); ++j) {
    beams.bearing_rad.push_back(std::atan2(ends.y_m[j], ends.x_m[j]));
    beams.range_m.push_back(std::hypot(ends.x_m[j], ends.y_m[j]));
    beams.quality.push_back(1.0);
  }
  return beams;
}

inline Matrix3 diagonal(double xx, double yy, double aa) {
  return {{{xx, 0, 0}, {0, yy, 0}, {0, 0, aa}}};
}

inline FilterParams sized(std::size_t min_particles, std::size_t max_particles) {
  FilterParams rule;
  rule.resample.min_particles = min_particles;
  rule.resample.max_particles = max_particles;
  return rule;
}

}  // namespace scenes
