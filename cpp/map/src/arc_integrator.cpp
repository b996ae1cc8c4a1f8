#include "mapperd/map/arc_integrator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/parallel.hpp"
#include "mapperd/map/fan_blocks.hpp"
#include "mapperd/map/polar_grid.hpp"

namespace mapperd::map {
namespace {

// Uncertainty of a pooled level: quantisation, and a sample that the neighbouring arc holds.
constexpr double kLevelFactor = 1.15;
constexpr double kLevelStep = 0.015;
// Log-uniform levels of the broad share.
constexpr double kBroadLow = 0.045;
constexpr double kBroadHigh = 7.5;
// The tail of pooled noise in open water, over its median.
constexpr double kNoiseScale = 3.5;
constexpr double kNoiseExponent = 1.82;
constexpr double kNoiseStep = 0.5;  // of quantisation, in medians of the noise
constexpr double kNoiseFirstReturn = 5.0;
// The two-way pattern is taken at this part of the elevation: the voxels of an arc are not points.
constexpr double kPatternScale = 0.9;
constexpr double kHalfPowerSinc = 0.44295;

constexpr int kLevelsPerOctave = 12;
constexpr std::uint8_t kBehind = 128;  // added to the code of an echo behind the first return
constexpr double kSumUnit = 0x1p-20;   // of sums of logarithms
constexpr int kMaxGroup = 64;          // beams

double gaussian_below(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(what);
}

double noise_below(double level) {
  return level <= kNoiseScale ? 0.0 : 1.0 - std::pow(level / kNoiseScale, -kNoiseExponent);
}

double level_of(int index) {
  return std::exp2((index - ArcModel::kUnitLevel) / double{kLevelsPerOctave});
}

// Twelfths of an octave above the lowest level; noise may lie below that.
int index_of_noise(float level) {
  const float octaves = fast_log(std::max(level, 1e-6F)) * 1.44269504F;
  return static_cast<int>(std::floor(octaves * kLevelsPerOctave + (ArcModel::kUnitLevel + 0.5F)));
}

int index_of_level(float level) {
  return std::clamp(index_of_noise(level), 0, ArcModel::kLevels - 1);
}

double broad_below(double level) {
  const double place =
      std::log(std::max(level, 1e-6) / kBroadLow) / std::log(kBroadHigh / kBroadLow);
  return std::clamp(place, 0.0, 1.0);
}

}  // namespace

ArcModel::ArcModel(const ArcParams& params, const IwloRule& rule)
    : params_(params), min_units_(rule.min_units()) {
  require(params.half_aperture_rad > 0 && params.half_aperture_rad < 1.0,
          "half_aperture_rad must lie between 0 and 1");
  require(params.beam_width_rad > 0 && params.beam_width_rad < 2.0,
          "beam_width_rad must lie between 0 and 2");
  require(params.spread_below > 0 && params.spread_above > 0 && params.spread_above < 100 &&
              params.spread_below < 100,
          "spread_below and spread_above must lie between 0 and 100");
  require(params.broad_share >= 0 && params.broad_share < 1, "broad_share must lie in [0, 1)");
  require(params.missed_share > 0 && params.missed_share < 1, "missed_share must lie in (0, 1)");
  require(params.first_return > 0 && params.quiet > 0 && std::isfinite(params.first_return) &&
              std::isfinite(params.quiet),
          "first_return and quiet must be positive numbers");
  require(params.behind_scale >= 0 && params.behind_scale <= 1, "behind_scale must lie in [0, 1]");
  require(params.min_step >= 0 && params.max_step > 0 && params.max_step <= kMaxLogOdds,
          "min_step must be 0 or more, and max_step between 0 and 127");
  const double sin_half = std::sin(params.half_aperture_rad);
  upper_.resize(kLevels * kElevations);
  lower_.resize(kLevels * kElevations);
  for (int level = 0; level < kLevels; ++level) {
    const double x = level_of(level);
    const double upper = kLevelFactor * x + kLevelStep;
    const double lower = std::max(x / kLevelFactor - kLevelStep, 1e-6);
    for (int e = 0; e < kElevations; ++e) {
      const double sine = (e + 0.5) / kElevations * sin_half;
      upper_[place(level, e)] = static_cast<float>(below(upper, sine));
      lower_[place(level, e)] = static_cast<float>(below(lower, sine));
    }
  }
  for (int level = 0; level < kNoiseLevels; ++level) {
    const double x = std::exp2(level / double{kLevelsPerOctave});
    noise_upper_.push_back(static_cast<float>(noise_below(kLevelFactor * x + kNoiseStep)));
    noise_lower_.push_back(static_cast<float>(noise_below(x / kLevelFactor - kNoiseStep)));
  }
  const int span = rule.max_units() - rule.min_units();
  probability_.reserve(static_cast<std::size_t>(span) + 1);
  for (int i = 0; i <= span; ++i) {
    const double log_odds = rule.log_odds(static_cast<std::int16_t>(rule.min_units() + i));
    probability_.push_back(static_cast<float>(1.0 / (1.0 + std::exp(-log_odds))));
  }
}

double ArcModel::pattern(double sine) const {
  const double stretch = kHalfPowerSinc / std::sin(params_.beam_width_rad / 2.0);
  const double x = std::max(3.14159265358979323846 * stretch * kPatternScale * sine, 1e-9);
  const double sinc = std::sin(x) / x;
  return std::max(sinc * sinc, 1e-4);
}

double ArcModel::below(double level, double sine) const {
  const double z = std::log(level / pattern(sine));
  const double narrow = gaussian_below(z / (z < 0 ? params_.spread_below : params_.spread_above));
  const double found =
      (1 - params_.broad_share) * narrow + params_.broad_share * broad_below(level);
  return params_.missed_share + (1 - params_.missed_share) * found;
}

// Of a quiet level far below that of a surface.
double ArcModel::free_step(const ArcParams& params) {
  constexpr double kQuietLevel = 0.1;
  const double found = params.broad_share * broad_below(kQuietLevel);
  return -std::log(params.missed_share + (1 - params.missed_share) * found);
}

double ArcModel::heard_up_to(double noise) const {
  const double quiet = kLevelFactor * params_.quiet * noise + kLevelStep;
  const double sin_half = std::sin(params_.half_aperture_rad);
  const double most = params_.missed_share + 0.25;
  double heard = 0.0;
  for (int e = 0; e < kElevations; ++e) {
    const double sine = (e + 0.5) / kElevations * sin_half;
    if (below(quiet, sine) > most) break;
    heard = (e + 1.0) / kElevations * sin_half;
  }
  return std::asin(heard);
}

namespace {

GridMemory& grid_memory() {
  static thread_local GridMemory memory;
  return memory;
}

// Pooled levels of the arc cells as codes: nothing, free, or an echo's level.
class LevelGrid : public PolarGrid {
 public:
  LevelGrid(GridMemory& memory, const ArcImage& levels, const ArcModel& model,
            const PingParams& settings, double edge_m)
      : PolarGrid(memory, beam_edge_sines(levels.image.bearings_rad, levels.image.beams), edge_m,
                  settings.min_range_m, model.params().half_aperture_rad) {
    const PingImage& image = levels.image;
    row_pitch_ = edge_m;
    measure_beams();
    index_bearings();
    beams_ = static_cast<int>(image.beams);
    const int image_rows = static_cast<int>(std::floor(image.max_range_m() / edge_m));
    if (image_rows < 1) return;
    constexpr int kRowsBeyond = 8;
    set_size(image_rows + kRowsBeyond, padded_beams(image.beams));
    std::fill(memory.codes.begin(), memory.codes.end(), kCodeNothing);
    group_.resize(static_cast<std::size_t>(rows_), 1);
    weight_.resize(static_cast<std::size_t>(rows_), 0.0F);
    noise_level_.resize(static_cast<std::size_t>(rows_), ArcModel::kUnitLevel);
    fill(levels, model, settings, image_rows);
    if (is_empty()) return;
    find_classes();
    dilate();
  }

  int beams() const { return beams_; }
  std::size_t size() const { return memory_.codes.size(); }
  double sin_free() const { return sin_free_; }

  // Arc cell of a point, in voxels; its code. False beyond the grid.
  struct Arc {
    std::uint32_t cell;
    std::uint8_t code;
    int row;
  };
  bool find(float range, float sine, Arc& arc) const {
    const auto row = static_cast<std::ptrdiff_t>(range);
    const double place = is_irregular() ? column_of(sine) : binned_column_of(sine);
    const auto column = static_cast<std::ptrdiff_t>(place);
    if (row >= rows_ || column < kMarginBeams || column >= kMarginBeams + beams_) return false;
    const int group = group_[static_cast<std::size_t>(row)];
    const std::ptrdiff_t first = (column - kMarginBeams) / group * group + kMarginBeams;
    arc.cell = static_cast<std::uint32_t>(row * stride_ + first);
    // Echoes are the same over a group; free space ends at each beam's own first return.
    arc.code = memory_.codes[static_cast<std::size_t>(row * stride_ + column)];
    arc.row = static_cast<int>(row);
    return true;
  }
  float weight(int row) const { return weight_[static_cast<std::size_t>(row)]; }
  int noise_level(int row) const { return noise_level_[static_cast<std::size_t>(row)]; }

 private:
  void fill(const ArcImage& levels, const ArcModel& model, const PingParams& settings,
            int image_rows) {
    const PingImage& image = levels.image;
    const auto beams = image.beams;
    const double pitch = image.range_resolution_m;
    const double beam = (high_sine() - low_sine()) / static_cast<double>(beams);
    std::vector<float> line(beams);
    std::vector<int> first(beams, image_rows);
    double loudest_noise = 0.0;
    int last_echo = -1;
    std::vector<float> pooled(beams);
    const ArcParams& params = model.params();
    for (int row = 0; row < image_rows; ++row) {
      const double near_m = row * edge_m_, far_m = near_m + edge_m_;
      const auto low = static_cast<std::size_t>(near_m / pitch);
      const std::size_t end = std::min(
          image.rows, std::max(static_cast<std::size_t>(std::ceil(far_m / pitch)), low + 1));
      std::fill(line.begin(), line.end(), 0.0F);
      double noise = 0.0;
      for (std::size_t k = low; k < end; ++k) {
        const float* const from = image.intensity + k * beams;
        for (std::size_t j = 0; j < beams; ++j) line[j] = std::max(line[j], from[j]);
        noise = std::max(noise, static_cast<double>(levels.noise[k]));
      }
      int group = 1;
      const double width = beam * (row + 0.5);  // of a beam, in voxels
      while (group < kMaxGroup && 2 * group * width <= 1.0) group *= 2;
      const auto i = static_cast<std::size_t>(row);
      group_[i] = group;
      weight_[i] = static_cast<float>(1.0 / std::max(group * width, 1e-3));
      noise_level_[i] = index_of_noise(static_cast<float>(noise));
      if (!(far_m > min_range_)) continue;
      loudest_noise = std::max(loudest_noise, noise);
      const auto quiet = static_cast<float>(params.quiet * noise);
      const auto heard =
          static_cast<float>(std::max(params.first_return, kNoiseFirstReturn * noise));
      for (std::size_t j = 0; j < beams; j += static_cast<std::size_t>(group)) {
        const std::size_t stop = std::min(beams, j + static_cast<std::size_t>(group));
        const float level = *std::max_element(line.begin() + static_cast<std::ptrdiff_t>(j),
                                              line.begin() + static_cast<std::ptrdiff_t>(stop));
        for (std::size_t b = j; b < stop; ++b) {
          if (level >= heard && first[b] == image_rows) first[b] = row;
          const bool behind = row > first[b];
          std::uint8_t& code =
              memory_.codes[i * static_cast<std::size_t>(stride_) + kMarginBeams + b];
          if (level > quiet) {
            code = static_cast<std::uint8_t>(kCodeOccupied + index_of_level(level) +
                                             (behind ? kBehind : 0));
            last_echo = row;
          } else if (!behind) {
            code = kCodeFree;
          }
        }
      }
    }
    if (!settings.carve_no_return) {
      for (std::size_t b = 0; b < beams; ++b) {
        if (first[b] != image_rows) continue;
        for (int row = 0; row < image_rows; ++row) {
          std::uint8_t& code =
              memory_.codes[static_cast<std::size_t>(row * stride_) + kMarginBeams + b];
          if (code == kCodeFree) code = kCodeNothing;
        }
      }
    }
    const int rows = settings.carve_no_return ? image_rows : last_echo + 1;
    if (rows * edge_m_ > min_range_) reach_m_ = rows * edge_m_;
    sin_free_ = std::sin(model.heard_up_to(loudest_noise));
  }

  void find_classes() {
    for (std::ptrdiff_t tile = 0; tile < tile_rows_; ++tile) {
      for (std::ptrdiff_t at = 0; at < tile_columns_; ++at) {
        std::uint8_t found = 0;
        for (int row = 0; row < kTileRows; ++row) {
          const std::uint8_t* const codes =
              memory_.codes.data() + (tile * kTileRows + row) * stride_ + at * kTileColumns;
          for (int k = 0; k < kTileColumns; ++k) {
            found |= codes[k] == kCodeNothing ? kHasNothing
                                              : (codes[k] == kCodeFree ? kHasFree : kHasOccupied);
          }
        }
        memory_.classes[static_cast<std::size_t>(tile * tile_columns_ + at)] = found;
      }
    }
  }

  int beams_ = 0;
  double sin_free_ = 0.0;
  std::vector<int> group_;
  std::vector<float> weight_;  // voxels of an arc cell's cross section, over those sampled
  std::vector<int> noise_level_;
};

// A voxel on an arc with an echo.
struct Candidate {
  std::uint32_t arc;
  std::int16_t units;
  std::uint8_t voxel;
  std::uint8_t code;
  std::uint8_t elevation;
  std::int16_t noise_level;
  float weight;
};

struct ArcCell {
  std::uint8_t cell;
  std::uint8_t free;  // voxels that silence frees
  std::uint32_t begin, end;
  std::array<std::uint8_t, kCellVoxels> codes;
};

struct ArcBlock {
  BlockKey key;
  CellSet free_cells;
  std::uint32_t begin, end;  // its cells
};

// What a ping says of the blocks of a cube.
struct CubeEvidence {
  std::vector<ArcBlock> blocks;
  std::vector<ArcCell> cells;
  std::vector<Candidate> candidates;
  PingStats stats;
  std::vector<Block> created;
};

class ArcUpdate {
 public:
  ArcUpdate(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
            const Transform& map_T_sonar, const PingParams& settings, const PingMotion& motion)
      : map_(map),
        model_(model),
        threads_(settings.threads),
        grid_(grid_memory(), levels, model, settings, map.resolution_m()),
        fan_(map, grid_, map_T_sonar, motion),
        elevations_per_sine_(
            static_cast<float>(ArcModel::kElevations / std::sin(model.params().half_aperture_rad))),
        sin_aperture_(static_cast<float>(std::sin(model.params().half_aperture_rad))),
        sin_free_(static_cast<float>(grid_.sin_free())),
        min_range_(static_cast<float>(settings.min_range_m / map.resolution_m())) {}

  PingStats run() {
    if (grid_.is_empty()) return {};
    cells_task_ = grid_.cells_task();
    grid_view_ = grid_.view();
    const std::vector<BlockCube> cubes = fan_.cubes();
    fan_.fetch(map_, cubes);
    const WriteLock lock(map_);
    revision_ = map_.next_revision();
    upper_.assign(grid_.size(), 0);
    lower_.assign(grid_.size(), 0);
    std::vector<CubeEvidence> found(cubes.size());
    run_parallel(cubes.size(), threads_, [&](std::size_t i) { look(cubes[i], found[i]); });
    map_.pool().reserve(cubes.size() * kCubeBlocks * kCubeBlocks * kCubeBlocks * kBlockCells);
    run_parallel(cubes.size(), threads_, [&](std::size_t i) { apply(found[i]); });
    PingStats stats;
    for (CubeEvidence& cube : found) {
      stats.occupied += cube.stats.occupied;
      stats.free += cube.stats.free;
      stats.blocks_visited += cube.stats.blocks_visited;
      stats.blocks_created += cube.created.size();
      for (const Block& block : cube.created) map_.insert(block);
    }
    return stats;
  }

 private:
  void look(const BlockCube& cube, CubeEvidence& found) {
    fan_.visit(cube, [&](const BlockCube& block) { look_at_block(block, found); }, 1);
  }

  void look_at_block(const BlockCube& at, CubeEvidence& found) {
    const BlockView view = fan_.view_of(at);
    if (fan_.classes_of(view) == kHasNothing) return;
    ++found.stats.blocks_visited;
    CellsTask task = cells_task_;
    constexpr double kFirstCell = -1.5 * kCellEdge;
    const Vec3 first = view.seen + kFirstCell * (view.step[0] + view.step[1] + view.step[2]);
    set(task.first, first);
    for (std::size_t i = 0; i < 3; ++i) {
      set(task.step[i], double{kCellEdge} * view.step[i]);
      set(task.voxel_step[i], view.step[i]);
    }
    CellPlaces places;
    kernels_.place_cells(task, grid_view_, places);
    const BlockKey key = fan_.absolute(at.first);
    const Block* const block = map_.find(key);
    ArcBlock record{key, 0, static_cast<std::uint32_t>(found.cells.size()), 0};
    for (int cell = 0; cell < kBlockCells; ++cell) {
      const unsigned classes = places.classes[static_cast<std::size_t>(cell)];
      if (classes == 0) continue;
      if (classes == kHasFree && is_heard(view, cell)) {
        record.free_cells |= cell_bit(cell);
        continue;
      }
      look_at_cell(view, block, cell, found);
    }
    record.end = static_cast<std::uint32_t>(found.cells.size());
    if (record.free_cells != 0 || record.begin != record.end) found.blocks.push_back(record);
  }

  static void set(float* to, const Vec3& v) {
    to[0] = static_cast<float>(v.x);
    to[1] = static_cast<float>(v.y);
    to[2] = static_cast<float>(v.z);
  }

  // Whether silence frees all of a cell.
  bool is_heard(const BlockView& view, int cell) const {
    const auto from_middle = [](int at) { return 4.0 * at - 6.0; };
    const Vec3 v = view.seen + from_middle(cell & 3) * view.step[0] +
                   from_middle(cell >> 2 & 3) * view.step[1] +
                   from_middle(cell >> 4) * view.step[2];
    const double range = std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
    return std::abs(v.z) + kCellReach < static_cast<double>(sin_free_) * (range - kCellReach);
  }

  void look_at_cell(const BlockView& view, const Block* block, int cell, CubeEvidence& found) {
    std::array<float, kCellVoxels> x, y, z;
    if (view.is_linear) {
      const int corner = offset_of_cell(cell);
      for (int v = 0; v < kCellVoxels; ++v) {
        const int offset = corner + offset_in_cell(v);
        const auto from_middle = [](int at) { return at - (kBlockEdge - 1) / 2.0; };
        const Vec3 at = view.seen + from_middle(offset & 15) * view.step[0] +
                        from_middle(offset >> 4 & 15) * view.step[1] +
                        from_middle(offset >> 8) * view.step[2];
        const auto i = static_cast<std::size_t>(v);
        x[i] = static_cast<float>(at.x);
        y[i] = static_cast<float>(at.y);
        z[i] = static_cast<float>(at.z);
      }
    } else {
      CellPoints points;
      fan_.places_of(view, cell, points);
      const double scale = 1.0 / grid_.edge_m();
      for (std::size_t i = 0; i < kCellVoxels; ++i) {
        x[i] = static_cast<float>(scale * points.x[i]);
        y[i] = static_cast<float>(scale * points.y[i]);
        z[i] = static_cast<float>(scale * points.z[i]);
      }
    }
    std::array<float, kCellVoxels> range, sine, height;
    for (std::size_t i = 0; i < kCellVoxels; ++i) {
      const float flat = x[i] * x[i] + y[i] * y[i];
      const float r = std::sqrt(flat + z[i] * z[i]);
      range[i] = r;
      sine[i] = -y[i] / (std::sqrt(flat) + 1e-20F);
      height[i] = std::abs(z[i]) / (r + 1e-20F);
    }
    ArcCell record{static_cast<std::uint8_t>(cell),
                   0,
                   static_cast<std::uint32_t>(found.candidates.size()),
                   0,
                   {}};
    std::optional<DenseCell> voxels;
    Voxel alike;
    for (std::size_t i = 0; i < kCellVoxels; ++i) {
      if (!(x[i] > 0) || range[i] < min_range_ || height[i] >= sin_aperture_) continue;
      LevelGrid::Arc arc;
      if (!grid_.find(range[i], sine[i], arc) || arc.code == kCodeNothing) continue;
      if (arc.code == kCodeFree) {
        if (height[i] < sin_free_) {
          record.codes[i] = kCodeFree;
          ++record.free;
        }
        continue;
      }
      if (record.begin == found.candidates.size() && !voxels) {
        voxels.emplace();
        read_cell(block, cell, *voxels, alike);
      }
      const int elevation =
          std::min(static_cast<int>(height[i] * elevations_per_sine_), ArcModel::kElevations - 1);
      const Candidate candidate{arc.cell,
                                voxels->units[i],
                                static_cast<std::uint8_t>(i),
                                arc.code,
                                static_cast<std::uint8_t>(elevation),
                                static_cast<std::int16_t>(grid_.noise_level(arc.row)),
                                grid_.weight(arc.row)};
      add_to_sums(candidate);
      found.candidates.push_back(candidate);
    }
    record.end = static_cast<std::uint32_t>(found.candidates.size());
    if (record.free != 0 || record.begin != record.end) found.cells.push_back(record);
  }

  void read_cell(const Block* block, int cell, DenseCell& voxels, Voxel& alike) const {
    if (block != nullptr && block->is_held(cell)) {
      block->copy_held(map_.rule(), map_.pool(), cell, voxels);
      return;
    }
    alike = block != nullptr ? block->alike(map_.rule(), cell) : Voxel{};
    voxels.units.fill(alike.units);
    voxels.count.fill(alike.count);
  }

  static int level_of_code(std::uint8_t code) { return (code & ~kBehind) - kCodeOccupied; }

  // Logarithms of 1 - p (1 - F) at the upper and the lower level.
  struct Terms {
    float upper, lower;
  };
  Terms terms_of(const Candidate& at) const {
    const float p = model_.probability(at.units);
    const int level = level_of_code(at.code);
    const float upper = 1.0F - p * (1.0F - model_.below_upper(level, at.elevation));
    const float lower = 1.0F - p * (1.0F - model_.below_lower(level, at.elevation));
    return {fast_log(upper), fast_log(lower)};
  }

  void add_to_sums(const Candidate& at) {
    const Terms terms = terms_of(at);
    const auto whole = [&](float term) {
      return static_cast<std::int64_t>(static_cast<double>(at.weight * term) / kSumUnit);
    };
    __atomic_fetch_add(&upper_[at.arc], whole(terms.upper), __ATOMIC_RELAXED);
    __atomic_fetch_add(&lower_[at.arc], whole(terms.lower), __ATOMIC_RELAXED);
  }

  float step_of(const Candidate& at) const {
    const int level = level_of_code(at.code);
    const int over_noise = level - at.noise_level;
    const Terms own = terms_of(at);
    const auto rest = [&](std::int64_t sum, float term) {
      const auto others = static_cast<float>(static_cast<double>(sum) * kSumUnit) - term;
      return fast_exp2(1.44269504F * std::min(others, 0.0F));
    };
    const float upper = noise_upper(over_noise) * rest(upper_[at.arc], own.upper);
    const float lower = noise_lower(over_noise) * rest(lower_[at.arc], own.lower);
    const float occupied = model_.below_upper(level, at.elevation) * upper -
                           model_.below_lower(level, at.elevation) * lower;
    const float empty = upper - lower;
    const auto most = static_cast<float>(model_.params().max_step);
    constexpr float kLeast = 1e-12F;
    if (empty < kLeast) return occupied > kLeast ? most : 0.0F;
    return std::clamp(fast_log(std::max(occupied, kLeast)) - fast_log(empty), -most, most);
  }
  float noise_upper(int level) const { return model_.noise_upper(level); }
  float noise_lower(int level) const { return model_.noise_lower(level); }

  void apply(CubeEvidence& cube) {
    CellPool::Cache pool(map_.pool());
    const IwloRule& rule = map_.rule();
    for (const ArcBlock& at : cube.blocks) {
      Block* const known = map_.find(at.key);
      std::optional<Block> fresh;
      Block& block = known != nullptr ? *known : fresh.emplace(at.key, rule);
      bool changed = false;
      for (std::uint32_t i = at.begin; i < at.end; ++i) {
        changed |= apply_cell(cube.cells[i], cube, block, pool);
      }
      cube.stats.free +=
          static_cast<std::size_t>(__builtin_popcountll(at.free_cells)) * kCellVoxels;
      changed |= block.add_free(rule, pool, at.free_cells);
      if (changed) block.revision = revision_;
      if (fresh && changed) cube.created.push_back(*fresh);
    }
  }

  bool apply_cell(const ArcCell& at, CubeEvidence& cube, Block& block, CellPool::Cache& pool) {
    const IwloRule& rule = map_.rule();
    if (at.begin == at.end && (block.at_floor() & cell_bit(at.cell)) != 0) return false;
    const CellVoxels voxels = block.open(rule, pool, at.cell);
    bool changed = false;
    if (at.free != 0) {
      cube.stats.free += at.free;
      changed = kernels_.apply(tables_, at.codes.data(), nullptr, voxels.units(), voxels.counts(),
                               rule.count_bytes());
    }
    for (std::uint32_t i = at.begin; i < at.end; ++i) {
      changed |= apply_candidate(cube.candidates[i], voxels, cube.stats);
    }
    block.close(rule, pool, at.cell);
    return changed;
  }

  bool apply_candidate(const Candidate& at, const CellVoxels& voxels, PingStats& stats) const {
    const IwloRule& rule = map_.rule();
    const ArcParams& params = model_.params();
    const bool behind = (at.code & kBehind) != 0;
    std::uint16_t count = voxels.count(at.voxel);
    float step = step_of(at);
    if (behind && count == 0 && step < static_cast<float>(params.min_step)) return false;
    if (behind && step < 0) {
      if (at.units <= 0) return false;
      step *= static_cast<float>(params.behind_scale);
    }
    auto units =
        static_cast<std::int64_t>(std::lround(std::ldexp(static_cast<double>(step), rule.shift())));
    if (units < 0 && at.units > 0) {
      units = -std::int64_t{rule.scaled_down(
          at.units, static_cast<std::int16_t>(std::min<std::int64_t>(-units, 32767)))};
      if (behind) units = std::max<std::int64_t>(units, -at.units);
    }
    ++stats.occupied;
    std::int16_t value = at.units;
    rule.add(units, value, count);
    const bool changed = value != voxels.units()[at.voxel] || count != voxels.count(at.voxel);
    voxels.units()[at.voxel] = value;
    voxels.set_count(at.voxel, count);
    return changed;
  }

  VoxelMap& map_;
  const ArcModel& model_;
  int threads_;
  LevelGrid grid_;
  FanBlocks fan_;
  float elevations_per_sine_;
  float sin_aperture_;
  float sin_free_;
  float min_range_;
  RuleTables tables_ = map_.rule().tables();
  const Kernels& kernels_ = kernels();
  GridView grid_view_{};
  CellsTask cells_task_{};
  std::vector<std::int64_t> upper_;
  std::vector<std::int64_t> lower_;
  std::uint64_t revision_ = 0;
};

}  // namespace

PingStats integrate_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                        const Transform& map_T_sonar, const PingParams& settings,
                        const PingMotion& motion) {
  check_ping(levels.image, settings);
  const BlockBox all;
  if (!map.limit().holds(all.first) || !map.limit().holds(all.last)) {
    throw std::logic_error("the arc rule needs the whole map: arcs reach beyond a part's box");
  }
  for (std::size_t row = 0; row < levels.image.rows; ++row) {
    if (!(levels.noise[row] > 0 && std::isfinite(levels.noise[row]))) {
      throw std::invalid_argument("noise must be positive numbers, one a row");
    }
  }
  check_reach(map, map_T_sonar, levels.image.max_range_m(), motion);
  return ArcUpdate(map, model, levels, map_T_sonar, settings, motion).run();
}

}  // namespace mapperd::map
