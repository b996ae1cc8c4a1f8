// A sonar that moves, by its own poses at transmission and when an echo is back: nothing in it is
// to first order. The range is found by going to and fro between pose and time.
#pragma once

#include "mapperd/common/vec.hpp"
#include "mapperd/map/ping_motion.hpp"

namespace oracle {

// Where a sonar of constant velocity and rate is, by time after transmission.
class Track {
 public:
  Track(const mapperd::Transform& map_T_sonar, const mapperd::map::PingMotion& motion)
      : pose_(map_T_sonar), motion_(motion) {}

  mapperd::Transform at(double time_s) const;
  mapperd::Vec3 position(double time_s) const;

  // Range, bearing and elevation at which a point of the map is heard.
  struct Heard {
    double range_m;
    double bearing_rad;
    double elevation_rad;
  };
  Heard heard(const mapperd::Vec3& point) const;
  // The point of the map that is heard so.
  mapperd::Vec3 point(const Heard& heard) const;

 private:
  mapperd::Transform pose_;
  mapperd::map::PingMotion motion_;
};

}  // namespace oracle
