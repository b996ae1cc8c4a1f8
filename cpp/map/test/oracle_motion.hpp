// The oracle of a sonar that moves: every sample of a voxel is looked for in the ping with the
// sonar's own poses, at transmission and when the sample's echo is back.
//
// Nothing in it is to first order: the range is found by going to and fro between pose and time,
// and the volume is sampled along many lines, each followed from crossing to crossing by bisection.
#pragma once

#include "mapperd/map/ping_motion.hpp"
#include "oracle.hpp"

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

// Of one voxel.
Parts parts_of_voxel(const mapperd::map::PingImage& image, const Track& track, const Settings& settings,
                     const Voxel& voxel);

}  // namespace oracle
