// Batches of scatterers of many patches, one array per quantity, so that the compiler can
// vectorise.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/acoustics/scatter.hpp"
#include "patches.hpp"

namespace mapperd::acoustics {

// Maximum nodes of a batch, and nodes that a vector loop may write beyond them.
constexpr std::size_t kNodes = 512;
constexpr std::size_t kLanes = 8;

// Properties that all nodes of a batch share. Were the two bools neighbours, they would be compared
// as one number, which waits until both have been written.
struct SharedTraits {
  const Leg* transmit;
  bool round;  // the surface is round
  const Leg* receive;
  bool lobe;  // some of it reflects specularly

  [[nodiscard]] bool same_leg() const { return transmit == receive; }
};

inline bool operator==(const SharedTraits& a, const SharedTraits& b) {
  return a.transmit == b.transmit && a.round == b.round && a.receive == b.receive &&
         a.lobe == b.lobe;
}

// One number per node.
template <typename Number>
using Each = Number[kNodes + kLanes];

// Nodes of some patches. Points are relative to the transmitter: single precision then places them
// to 1e-7 of the range.
struct Nodes {
  std::size_t count = 0;
  Each<std::int32_t> i, j;   // in their lattice, from the patch's first
  Each<std::uint32_t> bits;  // random, for level and angle
  Each<float> point_m[3];    // object's axes
  Each<float> normal[3];     // of the plane; of a round surface, and then of any length
  Each<float> height_m[2];   // of the plane over the transmitter and the receiver
  Each<float> gain;
  Each<float> mu, lobe_height, steepness, smoothness;
};

// Computes the quantities of one of the patches for its nodes from `first` on.
void place(const Footprints& footprints, const Patches& patches, std::size_t patch,
           const Strength& strength, double gain, const SharedTraits& traits, std::size_t first,
           Nodes& nodes);

// Nodes relative to a leg.
struct PolarPoints {
  Each<float> range_m;
  Each<float> way[3];  // unit vectors in the object's frame
  Each<float> s, w;
};

// Position in the grid and pressure of the nodes.
struct HeardNodes {
  Each<float> pressure;
  Each<float> turns;  // of phase, within one
  Each<std::int32_t> row;
  Each<float> column;        // from the grid's first
  Each<float> other_column;  // of the reversed path, if the sound goes both ways
};

// Computes the echoes of nodes.
class ScattererKernel {
 public:
  explicit ScattererKernel(const ScatterInput& echoes) : e_(echoes) {}
  const HeardNodes& heard(const SharedTraits& traits, const Nodes& nodes);

 private:
  void strengths(const SharedTraits& traits, const Nodes& nodes, const PolarPoints& back);

  const ScatterInput& e_;
  PolarPoints out_, back_;
  HeardNodes heard_;
  Each<float> cosine_[3];  // to the transmitter, to the receiver, half-way
  Each<float> area_;       // that is seen, over the plane's
  Each<float> section_;
  Each<float> there_, here_;  // the vertical pattern
};

}  // namespace mapperd::acoustics
