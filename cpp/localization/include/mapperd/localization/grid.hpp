/// \file
/// \brief A flat occupancy grid and its free cells.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

inline constexpr std::int8_t kFree = 0;
inline constexpr std::int8_t kOccupied = 100;
inline constexpr std::int8_t kUnknown = -1;  ///< any other value is unknown too

inline constexpr std::size_t kMaxGridSide = 32000;  ///< squared distances fit 32 bits

/// Placement of a grid's cells: cell (row, column) covers the square from column and row times the
/// resolution on, in the grid's frame, whose pose in the map frame is `origin`.
struct GridFrame {
  std::size_t rows = 0;
  std::size_t columns = 0;
  double resolution_m = 0.0;
  Pose2 origin;

  std::size_t cells() const { return rows * columns; }
};

/// A planar map of free, occupied and unknown cells.
struct OccupancyGrid {
  GridFrame frame;
  std::vector<std::int8_t> cells;  ///< row-major

  bool is(std::size_t row, std::size_t column, std::int8_t value) const {
    return cells[row * frame.columns + column] == value;
  }
};

/// \throws std::invalid_argument for a grid without cells, of more than kMaxGridSide cells along a
/// side, or with a resolution or origin that is not finite.
void check_frame(const GridFrame& frame);

/// Free cells, from which poses are drawn uniformly.
class FreeSpace {
 public:
  /// \throws std::invalid_argument where no cell is free.
  explicit FreeSpace(const OccupancyGrid& grid);

  std::size_t size() const { return cells_.size(); }
  Pose2 draw_pose(const Stream& stream, Purpose purpose, std::uint32_t particle) const;

 private:
  GridFrame frame_;
  std::vector<std::uint32_t> cells_;
};

}  // namespace mapperd::localization
