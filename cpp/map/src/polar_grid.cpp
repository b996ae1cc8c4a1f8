#include "mapperd/map/polar_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace mapperd::map {
namespace {

constexpr double kMaxGridCells = 1 << 30;
constexpr int kBinsPerBeam = 4;
constexpr double kUneven = 0.15;      // from beam to beam, relative to their width
constexpr std::ptrdiff_t kLane = 16;  // columns that the kernels take at once

}  // namespace

PolarGrid::PolarGrid(GridMemory& memory, std::vector<double> edge_sines, double edge_m,
                     double min_range_m, double half_aperture_rad)
    : memory_(memory),
      edge_m_(edge_m),
      min_range_(min_range_m),
      sin_half_(std::sin(half_aperture_rad)),
      cos_half_(std::cos(half_aperture_rad)),
      edge_sines_(std::move(edge_sines)) {}

void PolarGrid::measure_beams() {
  narrowest_ = std::numeric_limits<double>::infinity();
  double last = edge_sines_[1] - edge_sines_[0];
  for (std::size_t j = 0; j + 1 < edge_sines_.size(); ++j) {
    const double width = edge_sines_[j + 1] - edge_sines_[j];
    widest_ = std::max(widest_, width);
    narrowest_ = std::min(narrowest_, width);
    irregular_ = irregular_ || std::abs(width - last) > kUneven * std::min(width, last);
    last = width;
  }
  narrowest_ = std::max(narrowest_, 1e-6);
}

void PolarGrid::set_size(double rows, int beams) {
  rows_ = static_cast<std::ptrdiff_t>(std::ceil(rows / kTileRows)) * kTileRows;
  columns_ = std::ptrdiff_t{beams + 2 * kMarginBeams} * subcolumns_;
  stride_ = (columns_ + kLane - 1) / kLane * kLane;
  if (static_cast<double>(rows_) * static_cast<double>(stride_) > kMaxGridCells) {
    throw std::invalid_argument(
        "the evidence grid would have more than 2^30 cells: take larger voxels or less detail");
  }
  tile_rows_ = rows_ / kTileRows;
  tile_columns_ = stride_ / kTileColumns;
  memory_.codes.resize(static_cast<std::size_t>(rows_ * stride_));
  memory_.classes.resize(static_cast<std::size_t>(tile_rows_ * tile_columns_));
}

void PolarGrid::dilate() {
  dilate(kCellReach, memory_.cell_classes);
  dilate(kBlockReach, memory_.block_classes);
}

// In each bin of sines, four a beam, the column is a linear function.
void PolarGrid::index_bearings() {
  const std::size_t bins = kBinsPerBeam * (edge_sines_.size() - 1);
  bin_column_.resize(bins);
  bin_slope_.resize(bins);
  bins_per_sine_ = static_cast<double>(bins) / (high_sine() - low_sine());
  double low = bin_sine(0), low_column = column_of(low);
  for (std::size_t i = 0; i < bins; ++i) {
    const double high = bin_sine(i + 1), high_column = column_of(high);
    const double slope = (high_column - low_column) / (high - low);
    bin_slope_[i] = static_cast<float>(slope);
    bin_column_[i] = static_cast<float>(low_column - slope * low);
    low = high;
    low_column = high_column;
  }
}

double PolarGrid::bin_sine(std::size_t bin) const {
  const auto bins = static_cast<double>(kBinsPerBeam * (edge_sines_.size() - 1));
  return low_sine() + (high_sine() - low_sine()) * (static_cast<double>(bin) / bins);
}

double PolarGrid::column_of(double sine) const {
  const auto after = std::upper_bound(edge_sines_.begin() + 1, edge_sines_.end() - 1, sine);
  const auto beam = static_cast<std::size_t>(after - edge_sines_.begin()) - 1;
  const double width = std::max(edge_sines_[beam + 1] - edge_sines_[beam], 1e-9);
  return subcolumns_ *
         (kMarginBeams + static_cast<double>(beam) + (sine - edge_sines_[beam]) / width);
}

// For each tile the classes within `reach` voxels of any of its points, above and below.
void PolarGrid::dilate(float reach, std::vector<std::uint8_t>& wide) const {
  const auto tiles = static_cast<std::size_t>(tile_columns_);
  wide.resize(memory_.classes.size());
  std::vector<std::uint8_t> line(tiles), padded;
  const double reach_m = reach * edge_m_;
  const auto reach_rows = static_cast<std::ptrdiff_t>(std::ceil(reach_m / row_pitch_)) + 1;
  for (std::ptrdiff_t tile = 0; tile < tile_rows_; ++tile) {
    const std::ptrdiff_t low = (tile * kTileRows - reach_rows) / kTileRows;
    const std::ptrdiff_t high = (tile * kTileRows + kTileRows - 1 + reach_rows) / kTileRows;
    const std::ptrdiff_t first = std::max(low, std::ptrdiff_t{0});
    const std::ptrdiff_t last = std::min(high, tile_rows_ - 1);
    std::fill(line.begin(), line.end(), std::uint8_t{0});
    for (std::ptrdiff_t row = first; row <= last; ++row) {
      const std::uint8_t* const from = memory_.classes.data() + row * tile_columns_;
      for (std::size_t i = 0; i < tiles; ++i) line[i] |= from[i];
    }
    std::uint8_t beyond = kHasNothing;
    if (tile * kTileRows >= reach_rows && high < tile_rows_) beyond = 0;
    // A sideways step of t changes the sine by t / range at most.
    const double near_m =
        (static_cast<double>(tile * kTileRows) * row_pitch_ - reach_m) * cos_half_;
    const double columns = near_m > 0 ? reach_m / near_m / narrowest_ * subcolumns_ + 1 : 1e9;
    const auto sideways = static_cast<std::size_t>(
        std::min(std::ceil(columns / kTileColumns), static_cast<double>(tiles)));
    // OR over 2 sideways + 1 tiles, by doubling the run that each tile stands for.
    std::size_t run = 1;
    const std::size_t wanted = 2 * sideways + 1;
    std::uint8_t* const to = wide.data() + tile * tile_columns_;
    padded.assign(tiles + 2 * sideways, kHasNothing);
    std::copy(line.begin(), line.end(), padded.begin() + static_cast<std::ptrdiff_t>(sideways));
    while (2 * run <= wanted) {
      for (std::size_t i = 0; i + run < padded.size(); ++i) padded[i] |= padded[i + run];
      run *= 2;
    }
    for (std::size_t i = 0; i < tiles; ++i) {
      to[i] = static_cast<std::uint8_t>(padded[i] | padded[i + wanted - run] | beyond);
    }
  }
}

GridView PolarGrid::view() const {
  return {memory_.codes.data(),
          averages_ ? memory_.shares.data() : nullptr,
          memory_.cell_classes.data(),
          static_cast<std::int32_t>(stride_),
          static_cast<std::int32_t>(tile_columns_),
          static_cast<float>(rows_),
          static_cast<float>(columns_)};
}

CellsTask PolarGrid::cells_task() const {
  CellsTask task{};
  task.sin_half_aperture = static_cast<float>(sin_half_);
  task.cos_half_aperture = static_cast<float>(cos_half_);
  task.rows_per_voxel = static_cast<float>(edge_m_ / row_pitch_);
  task.sine_low = static_cast<float>(low_sine());
  const auto bins = static_cast<double>(bin_column_.size());
  task.bins_per_sine = static_cast<float>(bins_per_sine_);
  task.last_bin = static_cast<float>(bins - 0.5);
  task.bin_column = bin_column_.data();
  task.bin_slope = bin_slope_.data();
  task.reach = kCellReach;
  return task;
}

double PolarGrid::binned_column_of(double sine) const {
  const auto bins = static_cast<double>(bin_column_.size());
  const double bin = (sine - low_sine()) * bins_per_sine_;
  const auto i = static_cast<std::size_t>(std::clamp(bin, 0.0, bins - 0.5));
  return static_cast<double>(bin_column_[i]) + sine * static_cast<double>(bin_slope_[i]);
}

std::uint8_t PolarGrid::classes_of_block(double range_m, double sine) const {
  const auto place = [](double at, std::ptrdiff_t count, int tile) {
    return static_cast<std::ptrdiff_t>(std::clamp(at, 0.0, static_cast<double>(count) - 0.5)) /
           tile;
  };
  const std::ptrdiff_t row = place(range_m / row_pitch_, rows_, kTileRows);
  const std::ptrdiff_t column = place(binned_column_of(sine), columns_, kTileColumns);
  return memory_.block_classes[static_cast<std::size_t>(row * tile_columns_ + column)];
}

}  // namespace mapperd::map
