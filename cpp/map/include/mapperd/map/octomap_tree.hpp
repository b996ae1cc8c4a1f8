// The records of an OctoMap tree, read once from the root down.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string_view>

#include "mapperd/map/octomap_header.hpp"

namespace mapperd::map {

// A node's space: 2^(16 - depth) voxels along each axis, from this key on.
struct OctomapCube {
  std::uint32_t x = 0;
  std::uint32_t y = 0;
  std::uint32_t z = 0;
  int depth = 0;

  std::uint32_t edge() const { return 1U << (kOctomapDepth - depth); }
  OctomapCube child(unsigned i) const {
    const std::uint32_t half = edge() / 2;
    return {x + half * (i & 1U), y + half * (i >> 1U & 1U), z + half * (i >> 2U), depth + 1};
  }
};

// OctoMap's default clamps, which are the log-odds of a .bt's leaves.
double octomap_free_log_odds();
double octomap_occupied_log_odds();

using OctomapVisit =
    std::function<void(std::size_t at, const OctomapCube& leaf, double log_odds)>;  // at: its byte

// Visits the leaves of the tree behind a header, those of a cube after each other, as far as the
// file is sound. Goes sixteen levels deep at most, in time proportional to the file's length.
// Throws std::invalid_argument for all that is not exactly the tree that the header promises.
void for_each_octomap_leaf(std::string_view file, const OctomapHeader& header,
                           const OctomapVisit& visit);

}  // namespace mapperd::map
