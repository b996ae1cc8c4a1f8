#include "mapperd/acoustics/sound_layers.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/acoustics/row_bands.hpp"

namespace mapperd::acoustics {

namespace {

constexpr double kMinLevel = 1e-9;               // of a direction straight up or down
constexpr std::size_t kMinRaysPerThread = 4096;  // that are worth a thread of their own

double turn_ray(const SoundLayers& layers, const double* point, double step_m, double turn_m,
                double* direction) {
  double speed_mps = 0.0;
  const double depth_m = -(point[2] + 0.5 * step_m * direction[2]);
  const double gradient = speed_gradient(layers, depth_m, speed_mps);
  if (gradient == 0.0) {
    return speed_mps;
  }
  const double level =
      std::max(std::sqrt(direction[0] * direction[0] + direction[1] * direction[1]), kMinLevel);
  const double turn = gradient * level / speed_mps * turn_m;
  const double cosine = std::cos(turn);
  const double sine = std::sin(turn);
  const double scale = (level * cosine + direction[2] * sine) / level;
  direction[2] = direction[2] * cosine - level * sine;
  direction[0] *= scale;
  direction[1] *= scale;
  return speed_mps;
}

}  // namespace

double speed_gradient(const SoundLayers& layers, double depth_m, double& speed_mps) {
  const auto& depths = layers.depth_m;
  const auto deeper = static_cast<std::size_t>(
      std::upper_bound(depths.begin(), depths.end(), depth_m) - depths.begin());
  if (deeper == 0 || deeper == depths.size()) {
    speed_mps = layers.speed_mps[deeper == 0 ? 0 : deeper - 1];
    return 0.0;
  }
  const double slope = (layers.speed_mps[deeper] - layers.speed_mps[deeper - 1]) /
                       (depths[deeper] - depths[deeper - 1]);
  speed_mps = layers.speed_mps[deeper - 1] + slope * (depth_m - depths[deeper - 1]);
  return -slope;
}

void turn_rays(const SoundLayers& layers, std::size_t count, const double* points,
               double* directions, double step_m, double turn_m, double* speeds, unsigned threads) {
  const auto shares = static_cast<unsigned>(count / kMinRaysPerThread);
  in_row_bands(count, std::min(threads, shares), [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      speeds[i] = turn_ray(layers, points + 3 * i, step_m, turn_m, directions + 3 * i);
    }
  });
}

void follow_rays(const SoundLayers& layers, std::size_t count, const double* origin_m,
                 double* directions, double step_m, std::size_t steps, double speed_mps,
                 double* corners, double* ranges_m) {
  for (std::size_t i = 0; i < count; ++i) {
    std::copy_n(origin_m, 3, corners + 3 * i);
    ranges_m[i] = 0.0;
  }
  for (std::size_t step = 0; step < steps; ++step) {
    // Half a turn first: then each piece has the mean direction of its part of the arc.
    const double turn_m = step == 0 ? 0.5 * step_m : step_m;
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t from = step * count + i;
      const std::size_t to = from + count;
      double* direction = directions + 3 * i;
      const double speed = turn_ray(layers, corners + 3 * from, step_m, turn_m, direction);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        corners[3 * to + axis] = corners[3 * from + axis] + step_m * direction[axis];
      }
      ranges_m[to] = ranges_m[from] + step_m * speed_mps / speed;
    }
  }
}

}  // namespace mapperd::acoustics
