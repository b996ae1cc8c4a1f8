/// \file
/// \brief The records of an OctoMap tree, read once from the root down.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string_view>

#include "mapperd/map/octomap_header.hpp"

namespace mapperd::map {

/// Extent of a node: 2^(16 - depth) voxels along each axis, from this key on.
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

/// OctoMap's default clamps, which are the log-odds of a .bt's leaves.
double octomap_free_log_odds();
double octomap_occupied_log_odds();

using OctomapVisit =
    std::function<void(std::size_t at, const OctomapCube& leaf, double log_odds)>;  // at: its byte

/// Visits the leaves of the tree behind a header, those of a cube after each other, up to the first
/// error. Goes sixteen levels deep at most, in time proportional to the file's length.
/// \throws std::invalid_argument unless the file is exactly the tree that its header states.
void for_each_octomap_leaf(std::string_view file, const OctomapHeader& header,
                           const OctomapVisit& visit);

}  // namespace mapperd::map
