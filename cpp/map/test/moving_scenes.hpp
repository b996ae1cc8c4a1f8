// Seeded random motions.
#pragma once

#include "mapperd/map/ping_motion.hpp"
#include "scenes.hpp"

namespace scenes {

inline mapperd::Vec3 random_direction(Random& random) {
  const double z = random.uniform(-1, 1);
  const double around = random.uniform(-3.14159, 3.14159);
  const double flat = std::sqrt(1 - z * z);
  return {flat * std::cos(around), flat * std::sin(around), z};
}

// Of a given speed and rate, in any direction; sound as slow as is said makes it matter more.
inline mapperd::map::PingMotion motion_of(double speed_mps, double rate_radps, Random& random,
                                     double speed_of_sound_mps = 1500.0) {
  return {speed_mps * random_direction(random), rate_radps * random_direction(random),
          random.uniform(-0.05, 0.05), speed_of_sound_mps};
}

}  // namespace scenes
