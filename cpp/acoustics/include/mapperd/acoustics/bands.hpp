/// \file
/// \brief Division of work among threads. Results do not depend on the number of threads.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "mapperd/acoustics/scatter.hpp"

namespace mapperd::acoustics {

/// Hits first .. last and the columns that their echoes can reach.
struct Band {
  std::size_t first, last;
  std::ptrdiff_t column, columns;
};

std::vector<Band> bands_of(const ScatterInput& echoes, int threads);

/// Runs task(band) for each band on at most `threads` threads; bands that share columns run one
/// after another, in an order that does not depend on the number of threads.
void in_bands(const std::vector<Band>& bands, int threads,
              const std::function<void(const Band&)>& task);

/// Column of a direction cosine s, relative to the grid's first column.
double column_of(const EchoGrid& grid, double s);

}  // namespace mapperd::acoustics
