// The scatterers of one patch side by side, so that the compiler can vectorise what happens to
// them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "acoustics/footprint.hpp"
#include "acoustics/lattice.hpp"
#include "acoustics/scatter.hpp"

namespace acoustics {

constexpr std::size_t kNodes = 256;

// What the nodes of a patch share.
struct PatchLaws {
  Axes axes;
  Vector normal;
  double offset;  // of the plane n.p
  Lattice lattice;
  const double* bent;  // of a round surface, or null
  const Leg* transmit;
  const Leg* receive;
  double transmit_height_m, receive_height_m;  // of the plane over the legs' origins
  float gain;                                  // of pressure, the node's area included
};

// Places within the lattice and random bits, one after another.
struct Nodes {
  std::size_t count = 0;
  double u[kNodes], v[kNodes];  // in steps, jitter included
  std::uint32_t bits[kNodes];   // for level and angle
  double point_m[3][kNodes];
};

// The nodes as a leg has them.
struct Sights {
  double range_m[kNodes];
  double way[3][kNodes];  // unit vectors in the object's frame
  float s[kNodes], w[kNodes];
};

// Where and how loudly the nodes are heard.
struct HeardNodes {
  float pressure[kNodes];
  float turns[kNodes];  // of phase, within one
  std::int32_t row[kNodes];
  float column[kNodes];  // from the grid's first
};

// Works nodes out, `count` of them.
class NodeWorks {
 public:
  explicit NodeWorks(const Echoes& echoes) : e_(echoes) {}
  const HeardNodes& heard(const PatchLaws& patch, const Strength& strength, Nodes& nodes);

 private:
  const Echoes& e_;
  Sights out_, back_;
  HeardNodes heard_;
  float cosine_[3][kNodes];  // to the transmitter, to the receiver, half-way
  float section_[kNodes];
  float there_[kNodes], here_[kNodes];  // the vertical pattern
};

}  // namespace acoustics
