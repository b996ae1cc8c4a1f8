// A flat occupancy grid and its free cells.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

inline constexpr std::int8_t kFree = 0;
inline constexpr std::int8_t kOccupied = 100;
inline constexpr std::int8_t kUnknown = -1;  // and so is any other value

inline constexpr std::size_t kMaxGridSide = 32000;  // squared distances fit 32 bits

// Where a grid's cells lie: cell (row, column) covers the square from column and row times the
// resolution on, in the grid's frame, whose pose in the map frame is `origin`.
struct GridFrame {
  std::size_t rows = 0;
  std::size_t columns = 0;
  double resolution_m = 0.0;
  Pose2 origin;

  std::size_t cells() const { return rows * columns; }
};

struct OccupancyGrid {
  GridFrame frame;
  std::vector<std::int8_t> cells;  // row-major

  bool is(std::size_t row, std::size_t column, std::int8_t value) const {
    return cells[row * frame.columns + column] == value;
  }
};

// Throws std::invalid_argument for a grid without cells, of more than kMaxGridSide cells along a
// side, or whose resolution or origin is no finite number.
void check_frame(const GridFrame& frame);

// The cells to draw from when nothing is known; each draw lies anywhere in its cell.
class FreeSpace {
 public:
  // Throws std::invalid_argument where no cell is free.
  explicit FreeSpace(const OccupancyGrid& grid);

  std::size_t size() const { return cells_.size(); }
  Pose2 draw_pose(const Stream& stream, Purpose purpose, std::uint32_t particle) const;

 private:
  GridFrame frame_;
  std::vector<std::uint32_t> cells_;
};

}  // namespace mapperd::localization
