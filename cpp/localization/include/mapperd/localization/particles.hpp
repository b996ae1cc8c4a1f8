/// \file
/// \brief The cloud: poses in the map frame and normalised log-weights, one array each.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

namespace mapperd::localization {

/// A planar pose: x and y in metres, yaw in radians counter-clockwise from x.
struct Pose2 {
  double x = 0.0;
  double y = 0.0;
  double yaw = 0.0;
};

/// Symmetric, in the order x, y, yaw.
using Matrix3 = std::array<std::array<double, 3>, 3>;

/// Weighted poses, one array per quantity.
struct Particles {
  std::vector<double> x;           ///< m
  std::vector<double> y;           ///< m
  std::vector<double> yaw;         ///< rad, in (-pi, pi]
  std::vector<double> log_weight;  ///< the weights' sum is 1

  std::size_t size() const { return x.size(); }
  Pose2 pose(std::size_t i) const { return {x[i], y[i], yaw[i]}; }
  /// Resizes; poses are undefined, weights equal.
  void resize(std::size_t count);
  void set(std::size_t i, const Pose2& pose) {
    x[i] = pose.x;
    y[i] = pose.y;
    yaw[i] = pose.yaw;
  }
};

bool is_finite(const Pose2& pose);

}  // namespace mapperd::localization
