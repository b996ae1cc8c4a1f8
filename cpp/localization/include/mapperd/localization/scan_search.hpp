/// \file
/// \brief Initial cloud from a scan, without a prior pose.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/grid.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

/// Parameters of a search of all free space for poses that explain a scan.
struct Search {
  std::size_t poses = 0;     ///< drawn from all free space and weighted
  double kappa = 1.0;        ///< tempering; reduced if few poses would carry the weight
  double jitter_m = 0.1;     ///< noise added to the poses that are kept, m
  double jitter_rad = 0.02;  ///< the same for their headings, rad
};

/// Draws `count` poses of equal weight from `search.poses` random poses, weighted by the scan. The
/// field should be broader than the distance of neighbouring poses. The result does not depend on
/// `threads`.
/// \throws std::invalid_argument if `search.poses` is less than `count`, or too large.
Particles drawn_by_scan(const FreeSpace& free, const LikelihoodField& field, const Endpoints& ends,
                        const Search& search, std::size_t count, const Stream& stream, int threads);

}  // namespace mapperd::localization
