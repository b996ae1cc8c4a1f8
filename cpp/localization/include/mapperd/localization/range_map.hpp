/// \file
/// \brief Expected ranges from a map, with sub-cell accuracy.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstdint>
#include <vector>

#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/grid.hpp"

namespace mapperd::localization {

inline constexpr std::size_t kRays = 8 * kBlock;  ///< cast at once

/// Rays from positions in cells of the padded map, with unit directions.
struct Rays {
  std::size_t count = 0;
  double u[kRays];
  double v[kRays];
  double along_u[kRays];
  double along_v[kRays];
};

inline constexpr double kNoExpectation = -1.0;

/// Each cell stores, for each octant of directions, how many columns a ray from anywhere in it can
/// advance without a hit. Rays step by these distances, near obstacles from cell to cell, and end
/// where they enter an occupied cell, to 1e-9 cells. Eight bytes per cell, twice that while built.
class RangeMap {
 public:
  /// \throws std::invalid_argument for a map without cells.
  RangeMap(const OccupancyGrid& grid, bool unknown_blocks, int threads);

  const GridFrame& frame() const { return frame_; }

  /// Writes ranges in cells: `most` without a hit up to there, kNoExpectation where the
  /// ray begins outside the map or leaves it before.
  void cast(const Rays& rays, double most, double* out) const;

  /// Returns the range of one ray of the map frame, m: `max_range_m` and kNoExpectation as above.
  double cast(const Pose2& ray, double max_range_m) const;

  std::size_t memory_bytes() const { return clear_.size() * sizeof(std::uint64_t); }

 private:
  GridFrame frame_;
  std::vector<std::uint64_t> clear_;  ///< a byte an octant, of the padded grid
};

}  // namespace mapperd::localization
