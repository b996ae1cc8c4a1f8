#include "oracle_motion.hpp"

#include <cmath>

namespace oracle {

using mapperd::Transform;
using mapperd::Vec3;

namespace {

// By an angle about an axis: the columns of the rotation's matrix (Rodrigues).
Vec3 rotated(const Vec3& axis, double angle, const Vec3& v) {
  const double c = std::cos(angle);
  return c * v + (std::sin(angle) * mapperd::cross(axis, v) + (1 - c) * dot(axis, v) * axis);
}

}  // namespace

Vec3 Track::position(double time_s) const {
  return pose_.translation + (time_s - motion_.valid_s) * motion_.linear_mps;
}

Transform Track::at(double time_s) const {
  const double since = time_s - motion_.valid_s;
  Transform pose = pose_;
  pose.translation = position(time_s);
  const double rate = norm(motion_.angular_radps);
  if (!(rate > 0)) return pose;
  const Vec3 axis = (1.0 / rate) * motion_.angular_radps;
  // Rows of map_R_sonar exp(w t): the old ones, turned the other way.
  for (Vec3& row : pose.rows) row = rotated(axis, -rate * since, row);
  return pose;
}

Track::Heard Track::heard(const Vec3& point) const {
  const double out = norm(point - position(0));
  double range = out;
  for (int i = 0; i < 30; ++i) {
    const double before = range;
    const double back = norm(point - position(2 * range / motion_.speed_of_sound_mps));
    range = 0.5 * (out + back);
    if (std::abs(range - before) < 1e-13 * range) break;
  }
  const Transform then = at(2 * range / motion_.speed_of_sound_mps);
  const Vec3 v = then.rotate_back(point - then.translation);
  return {range, std::atan2(-v.y, v.x), std::atan2(v.z, std::hypot(v.x, v.y))};
}

Vec3 Track::point(const Heard& heard) const {
  const Transform then = at(2 * heard.range_m / motion_.speed_of_sound_mps);
  const double flat = std::cos(heard.elevation_rad);
  const Vec3 ahead =
      then.rotate({flat * std::cos(heard.bearing_rad), -flat * std::sin(heard.bearing_rad),
                   std::sin(heard.elevation_rad)});
  double leg = heard.range_m;
  for (int i = 0; i < 60; ++i) {
    const Vec3 sent_leg = then.translation + leg * ahead - position(0);
    leg = 0.5 * (leg + 2 * heard.range_m - norm(sent_leg));
  }
  return then.translation + leg * ahead;
}

}  // namespace oracle
