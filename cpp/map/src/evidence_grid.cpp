#include "mapperd/map/evidence_grid.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "mapperd/common/parallel.hpp"

namespace mapperd::map {
namespace {

constexpr double kRowPitch = 0.3;     // in edges
constexpr double kColumnPitch = 0.5;  // in edges, at most, at the largest range
constexpr double kMaxGridCells = 1 << 30;
constexpr int kBinsPerBeam = 4;
constexpr int kRowsBeyond = 24;       // of nothing, for voxels of cells that end beyond the reach
constexpr double kUneven = 0.15;      // from beam to beam, relative to their width
constexpr int kRowsAtOnce = 64;       // by one thread
constexpr std::ptrdiff_t kLane = 16;  // columns that the kernels take at once

int padded_beams(std::size_t beams) {
  return (static_cast<int>(beams) + kGroupBeams - 1) / kGroupBeams * kGroupBeams;
}

// How badly multiples of a ratio avoid whole numbers: large for ratios whose multiples spread
// evenly.
double evenness(double ratio) {
  double least = 1.0;
  for (int m = 1; m <= 24; ++m) {
    const double multiple = m * ratio;
    least = std::min(least, m * std::abs(multiple - std::round(multiple)));
  }
  return least;
}

// A pitch up to a tenth finer than requested, such that few multiples are whole ping rows: then
// the rows of the grid meet those of the ping at all phases, and rounding to the nearest row
// neither widens nor narrows what is seen on average.
double uneven_pitch(double wanted_m, double ping_row_m) {
  double best = wanted_m;
  double best_evenness = -1.0;
  for (int i = 0; i <= 40; ++i) {
    const double pitch = wanted_m * (1.0 - 0.0025 * i);
    const double found = evenness(pitch / ping_row_m);
    if (found > best_evenness + 1e-9) {
      best = pitch;
      best_evenness = found;
    }
  }
  return best;
}

// The largest float that is not above a number: floats above the one are above the other.
float float_below(double value) {
  const auto near = static_cast<float>(value);
  return static_cast<double>(near) > value
             ? std::nextafter(near, -std::numeric_limits<float>::infinity())
             : near;
}

}  // namespace

std::size_t scratch_floats(const GridTask& task) {
  const auto beams = static_cast<std::size_t>(task.beams);
  return 6 * (3 * beams + 2 * (2 * kMarginBeams + 3 * kGroupBeams)) + beams + 64;
}

struct EvidenceGrid::Sums {
  std::vector<float> free_end;
  std::size_t end_row = 0;  // behind the last return
};

EvidenceGrid::EvidenceGrid(GridMemory& memory, const PingImage& image, const PingParams& settings,
                           const IwloRule& rule, double edge_m)
    : memory_(memory),
      edge_m_(edge_m),
      min_range_(settings.min_range_m),
      sin_half_(std::sin(settings.vertical_aperture_rad / 2)),
      cos_half_(std::cos(settings.vertical_aperture_rad / 2)),
      edge_sines_(beam_edge_sines(image.bearings_rad, image.beams)) {
  Sums sums;
  sum_returns(image, rule, settings.carve_no_return, sums);
  const double evidence_m = settings.carve_no_return
                                ? image.max_range_m()
                                : static_cast<double>(sums.end_row) * image.range_resolution_m;
  if (!(evidence_m > min_range_)) return;
  reach_m_ = evidence_m + kFootprintReach * edge_m;
  choose_pitch(image, settings.detail);
  index_bearings();
  const double rows = std::ceil(reach_m_ / row_pitch_) + std::ceil(kRowsBeyond * settings.detail);
  rows_ = static_cast<std::ptrdiff_t>(std::ceil(rows / kTileRows)) * kTileRows;
  columns_ = std::ptrdiff_t{padded_beams(image.beams) + 2 * kMarginBeams} * subcolumns_;
  stride_ = (columns_ + kLane - 1) / kLane * kLane;
  if (static_cast<double>(rows_) * static_cast<double>(stride_) > kMaxGridCells) {
    throw std::invalid_argument(
        "the evidence grid would have more than 2^30 cells: take larger voxels or less detail");
  }
  tile_rows_ = rows_ / kTileRows;
  tile_columns_ = stride_ / kTileColumns;
  const auto size = static_cast<std::size_t>(rows_ * stride_);
  averages_ = settings.aggregation == Aggregation::kMean;
  memory.codes.resize(size);  // every row is written
  if (averages_) memory.shares.resize(size);
  memory.classes.resize(static_cast<std::size_t>(tile_rows_ * tile_columns_));
  fill(image, sums, settings.threads);
  dilate(kCellReach, memory.cell_classes);
  dilate(kBlockReach, memory.block_classes);
}

void EvidenceGrid::choose_pitch(const PingImage& image, double detail) {
  row_pitch_ = uneven_pitch(kRowPitch * edge_m_ / detail, image.range_resolution_m);
  double widest = 0.0;
  narrowest_ = std::numeric_limits<double>::infinity();
  double last = edge_sines_[1] - edge_sines_[0];
  for (std::size_t j = 0; j + 1 < edge_sines_.size(); ++j) {
    const double width = edge_sines_[j + 1] - edge_sines_[j];
    widest = std::max(widest, width);
    narrowest_ = std::min(narrowest_, width);
    irregular_ = irregular_ || std::abs(width - last) > kUneven * std::min(width, last);
    last = width;
  }
  narrowest_ = std::max(narrowest_, 1e-6);
  const double wanted = std::ceil(widest * reach_m_ * detail / (kColumnPitch * edge_m_));
  subcolumns_ = static_cast<int>(std::clamp(wanted, 1.0, double{kMaxSubcolumns}));
}

// In each bin of sines, four a beam, the column is a linear function.
void EvidenceGrid::index_bearings() {
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

double EvidenceGrid::bin_sine(std::size_t bin) const {
  const auto bins = static_cast<double>(kBinsPerBeam * (edge_sines_.size() - 1));
  return low_sine() + (high_sine() - low_sine()) * (static_cast<double>(bin) / bins);
}

double EvidenceGrid::column_of(double sine) const {
  const auto after = std::upper_bound(edge_sines_.begin() + 1, edge_sines_.end() - 1, sine);
  const auto beam = static_cast<std::size_t>(after - edge_sines_.begin()) - 1;
  const double width = std::max(edge_sines_[beam + 1] - edge_sines_[beam], 1e-9);
  return subcolumns_ *
         (kMarginBeams + static_cast<double>(beam) + (sine - edge_sines_[beam]) / width);
}

void EvidenceGrid::sum_returns(const PingImage& image, const IwloRule& rule, bool carve_no_return,
                               Sums& sums) {
  const auto beams = static_cast<std::size_t>(padded_beams(image.beams));
  memory_.counted.resize((image.rows + 1) * beams);
  memory_.weighted.resize((image.rows + 1) * beams);
  std::fill_n(memory_.counted.begin(), beams, 0.0F);
  std::fill_n(memory_.weighted.begin(), beams, 0.0F);
  sums.free_end.assign(beams, 0.0F);
  std::vector<std::uint8_t> open(image.beams, 1);
  const float threshold = float_below(rule.params().intensity_threshold);
  const double least = rule.min_weight();
  const double scale = 1.0 / std::max(rule.largest_weight() - least, 1e-12);
  const auto weight_of = [&](float intensity) {
    return static_cast<float>(
        std::clamp((rule.occupied_weight(intensity) - least) * scale, 0.0, 1.0));
  };
  std::vector<float> weights(256, -1.0F);  // of whole intensities, as sonars send them
  const auto known_weight_of = [&](float intensity) {
    const int whole = intensity >= 0 && intensity < 256 ? static_cast<int>(intensity) : 0;
    if (static_cast<float>(whole) != intensity) return weight_of(intensity);
    float& weight = weights[static_cast<std::size_t>(whole)];
    if (weight < 0) weight = weight_of(intensity);
    return weight;
  };
  for (std::size_t row = 0; row < image.rows; ++row) {
    const float* const intensity = image.intensity + row * image.beams;
    float* const counted = memory_.counted.data() + (row + 1) * beams;
    float* const weighted = memory_.weighted.data() + (row + 1) * beams;
    std::copy_n(counted - beams, beams, counted);
    std::copy_n(weighted - beams, beams, weighted);
    const double end_m = static_cast<double>(row + 1) * image.range_resolution_m;
    if (!(end_m > min_range_)) continue;
    int returns = 0;
    for (std::size_t j = 0; j < image.beams; ++j) returns += intensity[j] > threshold ? 1 : 0;
    if (returns == 0) continue;
    sums.end_row = row + 1;
    const double begin_m = static_cast<double>(row) * image.range_resolution_m;
    for (std::size_t j = 0; j < image.beams; ++j) {
      if (!(intensity[j] > threshold)) continue;
      counted[j] += 1.0F;
      weighted[j] += known_weight_of(intensity[j]);
      if (open[j] == 0) continue;
      open[j] = 0;
      sums.free_end[j] = static_cast<float>(std::max(begin_m, min_range_));
    }
  }
  if (!carve_no_return) return;
  for (std::size_t j = 0; j < image.beams; ++j) {
    if (open[j] != 0) sums.free_end[j] = static_cast<float>(image.max_range_m());
  }
}

void EvidenceGrid::fill(const PingImage& image, const Sums& sums, int threads) {
  const int beams = padded_beams(image.beams);
  const int groups = beams / kGroupBeams;
  const double half_m = kFootprintReach * edge_m_;
  std::vector<float> width(static_cast<std::size_t>(groups));
  for (int group = 0; group < groups; ++group) {
    const auto first = static_cast<std::size_t>(group * kGroupBeams);
    const std::size_t end = std::min(first + kGroupBeams, image.beams);
    const double low = edge_sines_[first], high = edge_sines_[end];
    const double middle = 0.5 * (low + high);
    const double beam = std::max((high - low) / static_cast<double>(end - first), 1e-9);
    const double across = half_m * std::sqrt(std::max(1.0 - middle * middle, 0.0));
    width[static_cast<std::size_t>(group)] = static_cast<float>(std::max(across / beam, 1e-3));
  }
  const GridTask task{beams,
                      subcolumns_,
                      1.0F / static_cast<float>(subcolumns_),
                      static_cast<int>(image.rows),
                      static_cast<float>(row_pitch_),
                      static_cast<float>(half_m),
                      static_cast<float>(1.0 / image.range_resolution_m),
                      static_cast<float>(min_range_),
                      memory_.counted.data(),
                      memory_.weighted.data(),
                      sums.free_end.data(),
                      width.data(),
                      static_cast<float>(kOccupiedShare),
                      static_cast<float>(kFreeShare),
                      memory_.codes.data(),
                      averages_ ? memory_.shares.data() : nullptr,
                      memory_.classes.data(),
                      stride_,
                      tile_columns_};
  const auto chunks = static_cast<std::size_t>((rows_ + kRowsAtOnce - 1) / kRowsAtOnce);
  run_parallel(chunks, threads, [&](std::size_t chunk) {
    const std::unique_ptr<float[]> scratch(new float[scratch_floats(task)]);
    const auto first = static_cast<std::ptrdiff_t>(chunk) * kRowsAtOnce;
    kernels().build_rows(task, static_cast<int>(first),
                         static_cast<int>(std::min(first + kRowsAtOnce, rows_)), scratch.get());
  });
}

// For each tile the classes within `reach` voxels of any of its points, above and below.
void EvidenceGrid::dilate(float reach, std::vector<std::uint8_t>& wide) const {
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

GridView EvidenceGrid::view() const {
  return {memory_.codes.data(),
          averages_ ? memory_.shares.data() : nullptr,
          memory_.cell_classes.data(),
          static_cast<std::int32_t>(stride_),
          static_cast<std::int32_t>(tile_columns_),
          static_cast<float>(rows_),
          static_cast<float>(columns_)};
}

CellsTask EvidenceGrid::cells_task() const {
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

double EvidenceGrid::binned_column_of(double sine) const {
  const auto bins = static_cast<double>(bin_column_.size());
  const double bin = (sine - low_sine()) * bins_per_sine_;
  const auto i = static_cast<std::size_t>(std::clamp(bin, 0.0, bins - 0.5));
  return static_cast<double>(bin_column_[i]) + sine * static_cast<double>(bin_slope_[i]);
}

inline EvidenceGrid::SamplePlace EvidenceGrid::place_of(const Vec3& v) const {
  const double horizontal = std::sqrt(v.x * v.x + v.y * v.y);
  return {(horizontal * sin_half_ - std::abs(v.z) * cos_half_) / edge_m_,
          std::sqrt(horizontal * horizontal + v.z * v.z) / row_pitch_, -v.y / horizontal};
}

EvidenceGrid::Evidence EvidenceGrid::at(const Vec3& v) const { return at(v, place_of(v)); }

CodeCounts EvidenceGrid::at(const CellPoints& points, std::uint8_t* codes,
                            std::uint8_t* shares) const {
  std::array<double, CellPoints::kCount> inside, row, sine;
  for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
    const SamplePlace place = place_of(points.at(i));
    inside[i] = place.inside;
    row[i] = place.row;
    sine[i] = place.sine;
  }
  CodeCounts found{0, 0};
  for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
    const Evidence evidence = at(points.at(i), {inside[i], row[i], sine[i]});
    codes[i] = evidence.code;
    shares[i] = evidence.share;
    found.occupied += evidence.code >= kCodeOccupied ? 1 : 0;
    found.free += evidence.code == kCodeFree ? 1 : 0;
  }
  return found;
}

inline EvidenceGrid::Evidence EvidenceGrid::at(const Vec3& v, const SamplePlace& at) const {
  const auto& [inside, row, sine] = at;
  if (!(v.x > 0) || inside <= -kOccupiedSlack) return {};
  const double column = irregular_ ? column_of(sine) : binned_column_of(sine);
  const auto place = [](double where, std::ptrdiff_t count) {
    return static_cast<std::ptrdiff_t>(std::clamp(where, 0.0, static_cast<double>(count) - 0.5));
  };
  const std::ptrdiff_t index = place(row, rows_) * stride_ + place(column, columns_);
  const std::uint8_t code = memory_.codes[static_cast<std::size_t>(index)];
  if (inside <= 0 && code < kCodeOccupied) return {};
  return {code, averages_ ? memory_.shares[static_cast<std::size_t>(index)] : std::uint8_t{0}};
}

std::uint8_t EvidenceGrid::classes_of_block(double range_m, double sine) const {
  const auto place = [](double at, std::ptrdiff_t count, int tile) {
    return static_cast<std::ptrdiff_t>(std::clamp(at, 0.0, static_cast<double>(count) - 0.5)) /
           tile;
  };
  const std::ptrdiff_t row = place(range_m / row_pitch_, rows_, kTileRows);
  const std::ptrdiff_t column = place(binned_column_of(sine), columns_, kTileColumns);
  return memory_.block_classes[static_cast<std::size_t>(row * tile_columns_ + column)];
}

}  // namespace mapperd::map
