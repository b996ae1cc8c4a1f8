// Batches of patches: the lattices that their scatterers lie on, and which nodes are theirs.
#pragma once

#include <cstddef>
#include <cstdint>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/acoustics/scatter.hpp"

namespace mapperd::acoustics {

// A vector that is linear over a patch: at its first node, and its growth per step of the lattice.
struct Linear {
  PerHit<double> first[3], along[3], across[3];
};

// Four sides of patches, in steps of their lattices; scanned by lines of nodes.
struct Outlines {
  PerHit<double> along[4], across[4];  // corners
  PerHit<double> along_per_across[4];  // of the sides that begin there: along over across
  PerHit<double> first_along, first_across;
  PerHit<double> lines;
  PerHit<bool> turned;  // lines run along j
};

// One number or vector per hit of the footprints that they were made from.
struct Patches {
  PerHit<bool> exists;
  PerHit<double> step_m;            // the lattice's longer one
  PerHit<double> root_area_m;       // of a node
  PerHit<std::uint64_t> key;        // of the lattice
  PerHit<double> first_i, first_j;  // from which its nodes are counted
  Linear place;                     // on the plane, relative to the transmitter
  Linear normal;                    // of round surfaces, of any length
  Outlines outline;
};

// Lays the lattices of footprints.
void make_patches(const ScatterInput& echoes, const Footprints& footprints, Patches& patches);

// Maximum lines processed at once.
constexpr std::size_t kLines = 64;

// Nodes on some lines of an outline, counted from its first ones: from `first` on, `count` of them.
// Patches that share an edge share no node.
struct Lines {
  std::size_t size;
  std::int32_t first[kLines], count[kLines];
};

void scan(const Outlines& outlines, std::size_t patch, std::size_t from, Lines& lines);

}  // namespace mapperd::acoustics
