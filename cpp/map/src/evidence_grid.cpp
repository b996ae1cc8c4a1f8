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
constexpr int kRowsBeyond = 24;       // of nothing, for voxels of cells that end beyond the reach
constexpr int kRowsAtOnce = 64;       // by one thread

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
    : PolarGrid(memory, beam_edge_sines(image.bearings_rad, image.beams), edge_m,
                settings.min_range_m, settings.vertical_aperture_rad / 2) {
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
  set_size(rows, padded_beams(image.beams));
  averages_ = settings.aggregation == Aggregation::kMean;
  if (averages_) memory.shares.resize(memory.codes.size());
  fill(image, sums, settings.threads);
  dilate();
}

void EvidenceGrid::choose_pitch(const PingImage& image, double detail) {
  row_pitch_ = uneven_pitch(kRowPitch * edge_m_ / detail, image.range_resolution_m);
  measure_beams();
  const double wanted = std::ceil(widest_ * reach_m_ * detail / (kColumnPitch * edge_m_));
  subcolumns_ = static_cast<int>(std::clamp(wanted, 1.0, double{kMaxSubcolumns}));
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

}  // namespace mapperd::map
