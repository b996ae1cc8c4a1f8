#include "mapperd/localization/grid.hpp"

#include <cmath>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {

void check_frame(const GridFrame& frame) {
  if (frame.rows == 0 || frame.columns == 0) {
    throw std::invalid_argument("the map must have cells");
  }
  if (frame.rows > kMaxGridSide || frame.columns > kMaxGridSide) {
    throw std::invalid_argument("the map must have at most 32000 cells along a side");
  }
  if (!(frame.resolution_m > 0.0) || !std::isfinite(frame.resolution_m)) {
    throw std::invalid_argument("the map's resolution must be above 0");
  }
  if (!is_finite(frame.origin)) throw std::invalid_argument("the map's origin must be finite");
}

FreeSpace::FreeSpace(const OccupancyGrid& grid) : frame_(grid.frame) {
  check_frame(frame_);
  for (std::size_t i = 0; i < grid.cells.size(); ++i) {
    if (grid.cells[i] == kFree) cells_.push_back(static_cast<std::uint32_t>(i));
  }
  if (cells_.empty()) throw std::invalid_argument("the map has no free cell to start from");
}

Pose2 FreeSpace::draw_pose(const Stream& stream, Purpose purpose, std::uint32_t particle) const {
  const Words words = draw(stream, purpose, particle);
  const auto pick =
      static_cast<std::size_t>((static_cast<std::uint64_t>(words.word[0]) * cells_.size()) >> 32);
  const std::size_t row = cells_[pick] / frame_.columns, column = cells_[pick] % frame_.columns;
  const double u = static_cast<double>(column) + uniform_of(words.word[1]);
  const double v = static_cast<double>(row) + uniform_of(words.word[2]);
  const double cosine = std::cos(frame_.origin.yaw) * frame_.resolution_m;
  const double sine = std::sin(frame_.origin.yaw) * frame_.resolution_m;
  return {frame_.origin.x + cosine * u - sine * v, frame_.origin.y + sine * u + cosine * v,
          wrapped(2.0 * kPi * uniform_of(words.word[3]))};
}

}  // namespace mapperd::localization
