/// \file
/// \brief The exact Euclidean distance transform of a flat grid.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstdint>
#include <vector>

#include "mapperd/localization/grid.hpp"

namespace mapperd::localization {

inline constexpr std::int32_t kBeyond = INT32_MAX;

/// For each cell, the squared distance in cells from its centre to the centre of the nearest cell
/// that is marked; kBeyond where that is further than `limit` cells. Columns by whole-number scans,
/// rows by the lower envelope of parabolas in whole numbers (Meijster, Roerdink and Hesselink
/// 2000): no rounding anywhere.
std::vector<std::int32_t> squared_distances(const std::vector<std::uint8_t>& marked,
                                            std::size_t rows, std::size_t columns,
                                            std::int32_t limit, int threads);

}  // namespace mapperd::localization
