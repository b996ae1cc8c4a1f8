// Drawing a cloud from a scan, where nothing is known of the pose.
#pragma once

#include <cstddef>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/grid.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

struct Search {
  std::size_t poses = 0;  // drawn from all free space and weighed
  double kappa = 1.0;     // tempering; less where few poses would carry the weight
  double jitter_m = 0.1;  // added to those that are kept
  double jitter_rad = 0.02;
};

// `count` poses of equal weight where the scan could have been taken: drawn by weight, of
// `search.poses` anywhere. A field that is broader than the poses lie apart lets those near the
// truth be seen. Threads change no value.
// Throws std::invalid_argument where there are fewer poses than are to be drawn, or too many.
Particles drawn_by_scan(const FreeSpace& free, const LikelihoodField& field, const Endpoints& ends,
                        const Search& search, std::size_t count, const Stream& stream, int threads);

}  // namespace mapperd::localization
