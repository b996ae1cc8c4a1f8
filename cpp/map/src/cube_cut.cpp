#include "mapperd/map/cube_cut.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace mapperd::map {
namespace {

// Widths below this part of the largest count as none: the error falls with its square.
constexpr double kFlat = 1e-5;

double cube_above(double x) { return x > 0 ? x * x * x : 0.0; }
double square_above(double x) { return x > 0 ? x * x : 0.0; }

}  // namespace

double part_beyond(const Vec3& normal, double offset) {
  std::array<double, 3> w{std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)};
  if (w[0] < w[1]) std::swap(w[0], w[1]);
  if (w[1] < w[2]) std::swap(w[1], w[2]);
  if (w[0] < w[1]) std::swap(w[0], w[1]);
  const double flat = kFlat * w[0];
  // The smaller side: there the sum has the fewest terms.
  const bool more_than_half = offset > 0;
  const double t = 0.5 * (w[0] + w[1] + w[2]) - std::abs(offset);
  if (!(t > 0)) return more_than_half ? 1.0 : 0.0;
  double part = 0.0;
  if (w[1] <= flat) {
    part = (t - 0.5 * (w[1] + w[2])) / w[0];
  } else if (w[2] <= flat) {
    const double s = t - 0.5 * w[2];
    part = (square_above(s) - square_above(s - w[0]) - square_above(s - w[1])) / (2 * w[0] * w[1]);
  } else {
    part = (cube_above(t) - cube_above(t - w[0]) - cube_above(t - w[1]) - cube_above(t - w[2]) +
            cube_above(t - w[1] - w[2])) /
           (6 * w[0] * w[1] * w[2]);
  }
  part = std::clamp(part, 0.0, 1.0);
  return more_than_half ? 1.0 - part : part;
}

}  // namespace mapperd::map
