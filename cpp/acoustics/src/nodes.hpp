// Batches of scatterers of many patches, one array per quantity, so that the compiler can
// vectorise.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/acoustics/lattice.hpp"
#include "mapperd/acoustics/scatter.hpp"

namespace mapperd::acoustics {

// Maximum nodes of a batch, and nodes that a vector loop may write beyond them.
constexpr std::size_t kNodes = 512;
constexpr std::size_t kLanes = 8;

// Properties that all nodes of a batch share.
struct SharedTraits {
  const Leg* transmit;
  const Leg* receive;
  bool round;  // the surface is round
  bool lobe;   // some of it reflects specularly

  [[nodiscard]] bool same_leg() const { return transmit == receive; }
};

inline bool operator==(const SharedTraits& a, const SharedTraits& b) {
  return a.transmit == b.transmit && a.receive == b.receive && a.round == b.round &&
         a.lobe == b.lobe;
}

// Properties that the nodes of a patch share.
struct PatchModel {
  Axes axes;
  Vec3 normal;
  double offset;  // of the plane n.p
  Lattice lattice;
  double first_i, first_j;                     // from which its nodes are counted
  const double* curved_normal;                 // of a round surface, or null
  double transmit_height_m, receive_height_m;  // of the plane over the legs' origins
  float gain;                                  // of pressure, the node's area included
  Strength strength;
};

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

// Four sides of a patch, in steps of its lattice; scanned by lines of nodes.
struct Outline {
  double along[4], across[4];  // corners
  double lean[4];              // of the sides that begin there: along over across
  double first_along, first_across;
  std::size_t lines;
  bool turned;  // lines run along j
};

Outline outline_of(const Corners& corner_m, const Axes& axes, const Lattice& lattice);

// Maximum lines processed at once.
constexpr std::size_t kLines = 64;

// Nodes on some lines of an outline, counted from its first ones: from `first` on, `count` of them.
// Patches that share an edge share no node.
struct Lines {
  std::size_t size;
  std::int32_t first[kLines], count[kLines];
};

void scan(const Outline& outline, std::size_t from, Lines& lines);

// Computes the quantities of a patch for its nodes from `first` on.
void place(const PatchModel& patch, const SharedTraits& traits, std::size_t first, Nodes& nodes);

// Nodes relative to a leg.
struct Sights {
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
  void strengths(const SharedTraits& traits, const Nodes& nodes, const Sights& back);

  const ScatterInput& e_;
  Sights out_, back_;
  HeardNodes heard_;
  Each<float> cosine_[3];  // to the transmitter, to the receiver, half-way
  Each<float> area_;       // that is seen, over the plane's
  Each<float> section_;
  Each<float> there_, here_;  // the vertical pattern
};

}  // namespace mapperd::acoustics
