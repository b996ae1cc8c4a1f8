// Update rules: the usual one, and those at the ends of what is allowed.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "mapperd/map/iwlo.hpp"
#include "scenes.hpp"

namespace rules {

inline std::vector<mapperd::map::IwloParams> extreme() {
  std::vector<mapperd::map::IwloParams> all(12);
  all[1].L_min = -127;
  all[1].L_max = 127;
  all[1].L_free = -127;
  all[2].L_free = 0;
  all[3].decay_rate = 0;  // settled at the first observation
  all[3].L_min = -127;
  all[4].decay_rate = 1.0 / 65534.5;  // settled at the largest count
  all[4].min_alpha = 0.5;
  all[5].adaptive_threshold = 1.0;
  all[5].L_max = 127;
  all[6].adaptive_update = false;
  all[6].L_min = -127;
  all[6].L_max = 127;
  all[7].adaptive_threshold = 0.2;
  all[7].L_free = -0.001;  // two units
  all[8].adaptive_threshold = 0.8;
  all[8].decay_rate = 0.02;  // counts of two bytes
  all[8].min_alpha = 0.1;
  all[9].protect_occupied = false;
  all[10].adaptive_threshold = 0.1;  // free steps are unscaled below p = 0.9
  all[10].L_free = -9;
  all[11].L_min = -0.25;  // the clamps nearer than one step
  all[11].L_max = 0.25;
  return all;
}

// States often lie where something changes.
inline std::int16_t random_units(const mapperd::map::IwloRule& rule, scenes::Random& random) {
  const auto around = [&](int units) { return rule.clamped(units + random.integer(-3, 3)); };
  switch (random.integer(0, 5)) {
    case 0:
      return around(rule.min_units());
    case 1:
      return around(rule.max_units());
    case 2:
      return around(rule.unscaled_up_to());
    case 3:
      return around(0);
    default:
      return rule.clamped(random.integer(rule.min_units(), rule.max_units()));
  }
}

inline std::uint16_t random_count(const mapperd::map::IwloRule& rule, scenes::Random& random) {
  const int settled = rule.settled_count();
  const int kind = random.integer(0, 3);
  if (kind == 0) return static_cast<std::uint16_t>(settled);
  if (kind == 1) return static_cast<std::uint16_t>(std::max(settled - random.integer(0, 3), 0));
  return static_cast<std::uint16_t>(random.integer(0, settled));
}

}  // namespace rules
