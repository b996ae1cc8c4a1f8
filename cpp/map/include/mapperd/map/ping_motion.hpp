/// \file
/// \brief A sonar that moves while its ping is in the water.
///
/// The sound leaves at time 0 and is back from range r at 2 r / c. Half the sum of both legs is the
/// range; bearing and elevation are those from where the sonar is then, as it is turned then. With
/// constant velocity and rate both ways between a place and where the image has it are known in
/// closed form. Places are relative to the sonar at transmission, in the map's axes; what is seen
/// there is given as a point of the fan of a sonar that had stayed as it was at transmission.
///
/// Far from the sonar's own size that is the motion to first order: ranges from where the sonar is
/// at r / c, directions as at 2 r / c.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <array>
#include <cstddef>

#include "mapperd/common/vec.hpp"

namespace mapperd::map {

/// Motion of the sonar, constant over one ping.
struct PingMotion {
  Vec3 linear_mps;       ///< velocity of the sonar, map frame, m/s
  Vec3 angular_radps;    ///< rate of turn, sonar's frame, rad/s
  double valid_s = 0.0;  ///< map_T_sonar is the pose at this time after transmission
  double speed_of_sound_mps = 1500.0;

  bool any() const { return dot(linear_mps, linear_mps) + dot(angular_radps, angular_radps) > 0; }
};

/// \throws std::invalid_argument for values that are not finite, for a sonar faster than a fiftieth
/// of sound, and for one that turns by more than a radian while the ping is in the water.
void check_motion(const PingMotion& motion, double max_range_m);

/// The rotation that the sonar had at transmission; the translation is left as it is.
Transform turned_to_transmission(const Transform& map_T_sonar, const PingMotion& motion);

/// Linearised view of a small piece of the map: the images of its axes.
struct SeenAxes {
  Vec3 x{1, 0, 0};
  Vec3 y{0, 1, 0};
  Vec3 z{0, 0, 1};

  /// A linear function of what is seen, as one of the place.
  Vec3 of_place(const Vec3& normal) const {
    return {dot(x, normal), dot(y, normal), dot(z, normal)};
  }
  Vec3 apply(const Vec3& v) const { return v.x * x + v.y * y + v.z * z; }
  double volume() const { return dot(x, cross(y, z)); }
};

/// Where a place appears in a moving sonar's image, m.
struct Seen {
  Vec3 at;
  SeenAxes axes;
};

/// The points of a cell's voxels, coordinate by coordinate: compilers take several at once.
struct CellPoints {
  static constexpr std::size_t kCount = 64;
  std::array<double, kCount> x, y, z;

  Vec3 at(std::size_t i) const { return {x[i], y[i], z[i]}; }
  void set(std::size_t i, const Vec3& v) {
    x[i] = v.x;
    y[i] = v.y;
    z[i] = v.z;
  }
};

/// Bound of the distortion of a ball by motion.
struct MotionBound {
  double stretch = 0.0;  ///< largest change of a length, relative to it
  double bend = 0.0;     ///< m, from what `SeenAxes` of its centre make of it
};

/// Converts between places at transmission and where a moving sonar's image shows them.
class MovingView {
 public:
  /// `map_R_sonar` at transmission.
  MovingView(const PingMotion& motion, const Transform& map_R_sonar);

  Vec3 seen(const Vec3& place) const;
  /// Applies seen() to each place, bit-exactly.
  void see(CellPoints& places) const;
  Seen look(const Vec3& place) const;
  /// Inverse of seen(): the place of a point of the fan.
  Vec3 place_of(const Vec3& seen) const;

  /// Returns bounds for the ball of a radius around a place.
  MotionBound motion_bound(const Vec3& place, double radius_m) const;
  /// Returns the distance, m, beyond which no place is seen nearer than `range_m`.
  double reach_m(double range_m) const { return range_m * (1 + speed_); }

 private:
  double range_of(const Vec3& place, double distance) const {
    return (distance - dot(place, linear_)) * scale_;
  }
  template <typename Turned>
  Vec3 seen_by(const Vec3& place) const;

  Vec3 linear_;   ///< velocity over the speed of sound
  Vec3 angular_;  ///< turn between transmission and reception, a metre of range, in the map's axes
  double speed_;
  double turn_;
  double scale_;
};

}  // namespace mapperd::map
