#include "mapperd/map/ping_motion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

namespace mapperd::map {
namespace {

constexpr double kMaxSpeed = 0.02;       // of that of sound
constexpr double kMaxTurn = 1.0;         // rad, from transmission to the last row
constexpr double kMaxTimeOffset = 60.0;  // s

bool is_finite(const Vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

// By the angle and about the axis of a vector (Rodrigues).
class Turn {
 public:
  explicit Turn(const Vec3& angle) : angle_(angle) {
    const double s = dot(angle, angle);
    if (s > 1) {
      const double a = std::sqrt(s);
      sine_ = std::sin(a) / a;
      cosine_ = (1 - std::cos(a)) / s;
      return;
    }
    // Series in the square of the angle, to the last digit of a double.
    if (s < kSmall) {
      sum<kTermsOfSmall>(s);
    } else {
      sum<kTerms>(s);
    }
  }

  Vec3 operator()(const Vec3& v) const {
    const Vec3 across = cross(angle_, v);
    return v + (sine_ * across + cosine_ * cross(angle_, across));
  }

  // Squares of angles below this take fewer terms.
  static constexpr double kSmall = 1e-3;  // nearly every ping turns less than two degrees

 protected:
  struct Small {};
  Turn(const Vec3& angle, Small /*tag*/) : angle_(angle) { sum<kTermsOfSmall>(dot(angle, angle)); }

 private:
  // What follows the last term is less than s^terms / (2 terms + 1)!, below half a last digit.
  static constexpr int kTermsOfSmall = 4;
  static constexpr int kTerms = 9;

  template <int kFrom>
  void sum(double s) {
    if constexpr (kFrom > 0) {
      constexpr int kN = 2 * kFrom - 1;
      constexpr double kOfSine = 1.0 / ((kN + 1) * (kN + 2));
      constexpr double kOfCosine = 1.0 / ((kN + 2) * (kN + 3));
      sine_ = 1 - s * sine_ * kOfSine;
      cosine_ = 1 - s * cosine_ * kOfCosine;
      sum<kFrom - 1>(s);
    } else {
      cosine_ *= 0.5;
    }
  }

  Vec3 angle_;
  double sine_ = 0.0;
  double cosine_ = 0.0;
};

// The same by an angle that is known to be small: without branches.
class SmallTurn : public Turn {
 public:
  explicit SmallTurn(const Vec3& angle) : Turn(angle, Small{}) {}
};

}  // namespace

void check_motion(const PingMotion& motion, double max_range_m) {
  const auto require = [](bool ok, const char* what) {
    if (!ok) throw std::invalid_argument(what);
  };
  const double c = motion.speed_of_sound_mps;
  require(std::isfinite(c) && c > 0, "motion: speed_of_sound_mps must be finite, above 0");
  require(is_finite(motion.linear_mps) && norm(motion.linear_mps) <= kMaxSpeed * c,
          "motion: linear_mps must be finite, at most a fiftieth of the speed of sound");
  require(is_finite(motion.angular_radps) &&
              2 * max_range_m / c * norm(motion.angular_radps) <= kMaxTurn,
          "motion: angular_radps must be finite, at most a radian while the ping lasts");
  require(std::isfinite(motion.valid_s) && std::abs(motion.valid_s) <= kMaxTimeOffset,
          "motion: valid_s must be finite, within a minute");
}

Transform turned_to_transmission(const Transform& map_T_sonar, const PingMotion& motion) {
  const Turn turn(motion.valid_s * motion.angular_radps);
  // map_R_sonar(0) = map_R_sonar(t) exp(-w t): its rows are those of map_R_sonar(t), turned on.
  Transform pose = map_T_sonar;
  for (Vec3& row : pose.rows) row = turn(row);
  return pose;
}

MovingView::MovingView(const PingMotion& motion, const Transform& map_R_sonar)
    : linear_((1.0 / motion.speed_of_sound_mps) * motion.linear_mps),
      angular_(map_R_sonar.rotate((2.0 / motion.speed_of_sound_mps) * motion.angular_radps)),
      speed_(norm(linear_)),
      turn_(norm(angular_)),
      scale_(1.0 / (1.0 - dot(linear_, linear_))) {}

// The range r solves |place| + |place - 2 r v / c| = 2 r, which is linear in r once it is squared.
template <typename Turned>
inline Vec3 MovingView::seen_by(const Vec3& place) const {
  const double distance = norm(place);
  const double range = range_of(place, distance);
  const Vec3 back = place - 2 * range * linear_;  // from where the sonar is at reception
  const Vec3 at = Turned(-range * angular_)((range / (2 * range - distance)) * back);
  const bool known = distance > 0;
  return {known ? at.x : 0.0, known ? at.y : 0.0, known ? at.z : 0.0};
}

Vec3 MovingView::seen(const Vec3& place) const { return seen_by<Turn>(place); }

void MovingView::see(CellPoints& places) const {
  double farthest = 0.0;  // squared
  for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
    farthest = std::max(farthest, dot(places.at(i), places.at(i)));
  }
  // The range is less than 1.03 times the distance, as no sonar exceeds `kMaxSpeed`.
  if (!(1.1 * farthest * turn_ * turn_ < Turn::kSmall)) {
    for (std::size_t i = 0; i < CellPoints::kCount; ++i) places.set(i, seen(places.at(i)));
    return;
  }
  for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
    places.set(i, seen_by<SmallTurn>(places.at(i)));
  }
}

Seen MovingView::look(const Vec3& place) const {
  const double distance = norm(place);
  if (!(distance > 0)) return {};
  const double range = range_of(place, distance);
  const Vec3 back = place - 2 * range * linear_;
  const double leg = 2 * range - distance;
  const Vec3 ahead = (1.0 / leg) * back;
  const Turn turn(-range * angular_);
  Seen seen;
  seen.at = turn(range * ahead);
  // Of the range along the map's axes; the turn itself grows with range.
  const Vec3 slope = scale_ * ((1.0 / distance) * place - linear_);
  const Vec3 turning = -1.0 * cross(angular_, seen.at);
  const auto axis = [&](const Vec3& unit, double step) {
    const Vec3 moved = unit - 2 * step * linear_;
    const Vec3 across = moved - dot(ahead, moved) * ahead;
    return turn(step * ahead + (range / leg) * across) + step * turning;
  };
  seen.axes = {axis({1, 0, 0}, slope.x), axis({0, 1, 0}, slope.y), axis({0, 0, 1}, slope.z)};
  return seen;
}

Vec3 MovingView::place_of(const Vec3& seen) const {
  const double range = norm(seen);
  if (!(range > 0)) return {};
  const Vec3 ahead = (1.0 / range) * Turn(range * angular_)(seen);
  const Vec3 moved = 2 * range * linear_;
  // |moved + leg ahead| + leg = 2 range.
  const double leg = (4 * range * range - dot(moved, moved)) / (4 * range + 2 * dot(moved, ahead));
  return moved + leg * ahead;
}

// With b the speed over that of sound, k the turn a metre of range and t = k r, first derivatives
// depart from the identity by 6 b + 2 t and second ones are at most 8 b / distance + 3 k, to first
// order; the rest is room for the limits of `check_motion`.
MotionBound MovingView::motion_bound(const Vec3& place, double radius_m) const {
  const double distance = norm(place);
  const double turned = turn_ * (distance + radius_m) / (1 - speed_);
  const double stretch = 7 * speed_ + 2.2 * turned;
  const double nearest = distance - radius_m;
  const double most = 2 * stretch * radius_m;
  if (!(nearest > 0)) return {stretch, most};
  const double second = turn_ * (3.5 + 1.3 * turned) + 10 * speed_ / nearest;
  return {stretch, std::min(0.5 * second * radius_m * radius_m, most)};
}

}  // namespace mapperd::map
