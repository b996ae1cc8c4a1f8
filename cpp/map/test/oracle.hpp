// The oracle: what evidence_grid.hpp defines, by plain sums over rows and beams in double
// precision.
//
// Slow and obvious: no grid, no sums kept, nothing of the library in it but the plain data types.
// A second oracle takes what the definition stands for: parts of a voxel's volume.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/iwlo.hpp"
#include "mapperd/map/ping.hpp"

namespace oracle {

struct Settings {
  double edge_m = 0.1;  // of a voxel
  mapperd::map::PingParams ping;
  mapperd::map::IwloParams iwlo;
};

struct Evidence {
  double returns = 0.0;  // N, F and W: parts of the footprint, or of the voxel
  double free = 0.0;
  double weighted = 0.0;

  double weight() const { return weighted / returns; }
};

enum class Class { kNothing, kFree, kOccupied };

Class class_of(const Evidence& evidence);

// How near the part that decides the class lies to its limit.
double distance_to_limit(const Evidence& evidence);

double weight_of(double intensity, const mapperd::map::IwloParams& params);

// What the footprint's width is measured in. Where all beams are as wide in sine both are the same;
// elsewhere the grid, whose columns are parts of beams, counts beams within a footprint alike.
enum class Measure { kSine, kBeams };

class PingOracle {
 public:
  PingOracle(const mapperd::map::PingImage& image, const Settings& settings,
             Measure measure = Measure::kSine);

  Evidence at(double range_m, double sine) const;
  // The same at a point of the sonar's frame, if the aperture lets it be.
  Evidence at(const mapperd::Vec3& in_sonar) const;

  // In voxel edges, positive inside the aperture's faces.
  double inside_aperture(const mapperd::Vec3& in_sonar) const;
  static double sine_of(const mapperd::Vec3& in_sonar);

  // In beams, from the first one's outer edge on; and the way back.
  double place_of(double sine) const;
  double sine_at(double place) const;
  // Half a footprint, in beams.
  double half_width(double range_m, double sine) const;

  // Of a cube of the sonar's frame, turned by a pose: n x n x n points, each anywhere in its part.
  Evidence volume(const mapperd::Vec3& centre, const mapperd::Transform& map_T_sonar, int n,
                  std::uint64_t seed) const;

 private:
  bool is_return(std::size_t row, std::size_t beam) const;
  double mean_width(double sine) const;  // of the beams in the group of eight around it
  double cosine(double sine) const;      // of the group's middle
  std::size_t beam_at(double sine) const;

  mapperd::map::PingImage image_;
  Settings settings_;
  Measure measure_;
  std::vector<double> edges_;       // sines
  std::vector<double> free_end_m_;  // by beam; no more than min_range where nothing is free
};

// Clamped, and never rounded.
struct State {
  double log_odds = 0.0;
  int count = 0;
};

void update(State& state, const Evidence& evidence, const Settings& settings);

}  // namespace oracle
