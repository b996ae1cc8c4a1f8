// The converged oracle: the rule for one ping, evaluated over each voxel's volume by brute force.
//
// The published mapper's rays, ever finer: thousands of sub-rays through the fan, each walked voxel
// by voxel, each piece of it weighed with its volume r^2 cos(e) dr de db. Slow and obvious, in
// double precision, and with nothing of the library in it but the plain data types.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <vector>

#include "mapperd/map/fan.hpp"
#include "mapperd/map/iwlo.hpp"
#include "mapperd/common/vec.hpp"

namespace oracle {

using Voxel = std::array<std::int64_t, 3>;

struct Parts {
  double occupied = 0.0;  // parts of the voxel's volume
  double free = 0.0;
  double weighted = 0.0;  // sum of w(I) over the occupied part

  double weight() const { return weighted / occupied; }
};

enum class Class { untouched, free, occupied };

struct Settings {
  double resolution_m = 0.1;
  mapperd::map::FanSettings fan;
  mapperd::map::IwloParams iwlo;
  // Across one voxel at the maximum range. The error falls with the square of it: at 250 the
  // oracle itself is good to some 4e-5 in log-odds.
  int rays_per_voxel = 250;
};

double weight_of(double intensity, const mapperd::map::IwloParams& params);
// In radians, half way between beams in sine.
std::vector<double> edges_of(const mapperd::map::PingImage& image);

std::map<Voxel, Parts> parts_of_ping(const mapperd::map::PingImage& image,
                                     const mapperd::Transform& map_T_sonar,
                                     const Settings& settings);

Class class_of(const Parts& parts);

// How near the part that decides the class lies to its limit, as a part of the volume.
double distance_to_limit(const Parts& parts);

struct State {
  double log_odds = 0.0;
  int count = 0;
};

void update(State& state, const Parts& parts, const Settings& settings);

}  // namespace oracle
