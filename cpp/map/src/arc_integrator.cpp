#include "mapperd/map/arc_integrator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/parallel.hpp"
#include "mapperd/common/simd.hpp"
#include "mapperd/map/fan_blocks.hpp"
#include "mapperd/map/polar_grid.hpp"

namespace mapperd::map {
namespace {

constexpr double kNoiseFirstReturn = 5.0;  // over the median of the noise
constexpr std::uint8_t kBehind = 128;      // added to the code of an echo behind the first return
constexpr int kMaxGroup = 64;              // beams
// Sums of logarithms, as whole numbers: of the upper and the lower level in one word.
constexpr float kSumUnit = 0x1p-18F;
constexpr float kMaxTerm = 0x1p12F;

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
    group_mask_.resize(static_cast<std::size_t>(rows_), -1);
    weight_.resize(static_cast<std::size_t>(rows_), 0.0F);
    noise_level_.resize(static_cast<std::size_t>(rows_), ArcModel::kUnitLevel);
    fill(levels, model, settings, image_rows);
    if (is_empty()) return;
    find_classes();
    dilate();
  }

  int beams() const { return beams_; }
  std::ptrdiff_t rows() const { return rows_; }
  std::size_t size() const { return memory_.codes.size(); }
  double sin_free() const { return sin_free_; }

  /// First column of the arc cells that a row's columns belong to: those columns and this mask.
  const std::int32_t* group_masks() const { return group_mask_.data(); }
  std::uint8_t code(std::size_t at) const { return memory_.codes[at]; }
  double exact_column_of(double sine) const { return column_of(sine); }
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
      group_mask_[i] = ~(group - 1);
      weight_[i] = static_cast<float>(1.0 / std::max(group * width, 1e-3));
      noise_level_[i] = ArcModel::index_of_noise(static_cast<float>(noise));
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
            code = static_cast<std::uint8_t>(kCodeOccupied + ArcModel::index_of_level(level) +
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
  std::vector<std::int32_t> group_mask_;
  std::vector<float> weight_;  // voxels of an arc cell's cross section, over those sampled
  std::vector<int> noise_level_;
};

// Voxels on arcs with an echo, an array a field; and what is computed for them.
class Candidates {
 public:
  std::size_t count = 0;
  std::vector<std::uint32_t> arc;
  std::vector<std::uint8_t> voxel;  // of its cell; with kBehind
  std::vector<std::uint8_t> noise;  // places in the model's tables
  std::vector<std::uint16_t> place;
  std::vector<std::int16_t> units;
  std::vector<std::int16_t> change;  // of the map's units, by this ping
  std::vector<float> weight, upper, lower, sum_upper, sum_lower, step;

  void make_room_for_a_cell() {
    if (count + kCellVoxels <= arc.size()) return;
    const std::size_t size = 2 * arc.size() + 4096;
    arc.resize(size);
    voxel.resize(size);
    noise.resize(size);
    place.resize(size);
    units.resize(size);
    change.resize(size);
    for (auto* const numbers : {&weight, &upper, &lower, &sum_upper, &sum_lower, &step}) {
      numbers->resize(size);
    }
  }
  ArcModel::Voxels voxels(std::size_t first, std::size_t end) const {
    return {end - first, &units[first], &place[first], &noise[first]};
  }
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
  Candidates candidates;
  PingStats stats;
  std::vector<Block> created;
  const std::int16_t* earlier = nullptr;  // changes that this ping made before
  std::size_t earlier_count = 0;

  void clear() {
    blocks.clear();
    cells.clear();
    candidates.count = 0;
    stats = {};
    created.clear();
    earlier = nullptr;
    earlier_count = 0;
  }
};

// Memory of a ping's cubes, reused for the next ping of the same thread.
std::vector<CubeEvidence>& evidence_memory() {
  static thread_local std::vector<CubeEvidence> memory;
  return memory;
}

// Voxels of a cell in the sonar frame, in voxels, and in the grid.
struct CellView {
  alignas(32) float x[kCellVoxels], y[kCellVoxels], z[kCellVoxels];
  alignas(32) float range[kCellVoxels], sine[kCellVoxels], height[kCellVoxels];  // a share of range
  alignas(32) std::int32_t row[kCellVoxels], column[kCellVoxels], elevation[kCellVoxels];
  alignas(32) std::int32_t inside[kCellVoxels];  // not 0: a place of the grid within the aperture
};

MAPPERD_VECTORISED void set_linear(const float* corner, const float (*step)[3], CellView& view) {
  for (int v = 0; v < kCellVoxels; ++v) {
    const auto i = static_cast<float>(v & 3), j = static_cast<float>(v >> 2 & 3);
    const auto k = static_cast<float>(v >> 4);
    view.x[v] = corner[0] + i * step[0][0] + j * step[1][0] + k * step[2][0];
    view.y[v] = corner[1] + i * step[0][1] + j * step[1][1] + k * step[2][1];
    view.z[v] = corner[2] + i * step[0][2] + j * step[1][2] + k * step[2][2];
  }
}

MAPPERD_VECTORISED void set_polar(const CellsTask& task, CellView& view) {
  for (int v = 0; v < kCellVoxels; ++v) {
    const float flat = view.x[v] * view.x[v] + view.y[v] * view.y[v];
    const float range = __builtin_sqrtf(flat + view.z[v] * view.z[v]);
    const float sine = -view.y[v] / (__builtin_sqrtf(flat) + 1e-20F);
    const float bin = (sine - task.sine_low) * task.bins_per_sine;
    const float positive = bin > 0.0F ? bin : 0.0F;
    const auto at = static_cast<std::int32_t>(positive < task.last_bin ? positive : task.last_bin);
    view.range[v] = range;
    view.sine[v] = sine;
    view.height[v] = __builtin_fabsf(view.z[v]) / (range + 1e-20F);
    view.column[v] = static_cast<std::int32_t>(task.bin_column[at] + task.bin_slope[at] * sine);
  }
}

struct GridEnds {
  std::int32_t rows, columns_end;
  float min_range, sin_aperture, elevations_per_sine;
};

MAPPERD_VECTORISED void set_inside(const GridEnds& ends, CellView& view) {
  for (int v = 0; v < kCellVoxels; ++v) {
    const float far = static_cast<float>(ends.rows);
    view.row[v] = static_cast<std::int32_t>(view.range[v] < far ? view.range[v] : far);
    const float elevation = view.height[v] * ends.elevations_per_sine;
    const float highest = static_cast<float>(ArcModel::kElevations - 1);
    view.elevation[v] = static_cast<std::int32_t>(elevation < highest ? elevation : highest);
    view.inside[v] = (view.x[v] > 0.0F) & (view.range[v] >= ends.min_range) &
                     (view.height[v] < ends.sin_aperture) & (view.row[v] < ends.rows) &
                     (view.column[v] >= kMarginBeams) & (view.column[v] < ends.columns_end);
  }
}

MAPPERD_VECTORISED void to_words(std::size_t count, const float* weight, const float* upper,
                                 const float* lower, std::uint32_t* high, std::uint32_t* low) {
  for (std::size_t i = 0; i < count; ++i) {
    const float scale = -weight[i] / kSumUnit;
    const float u = upper[i] * scale, l = lower[i] * scale;
    constexpr float kMost = kMaxTerm / kSumUnit;
    high[i] = static_cast<std::uint32_t>(static_cast<std::int32_t>(u < kMost ? u : kMost));
    low[i] = static_cast<std::uint32_t>(static_cast<std::int32_t>(l < kMost ? l : kMost));
  }
}

class ArcUpdate {
 public:
  ArcUpdate(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
            const Transform& map_T_sonar, const PingParams& settings, const PingMotion& motion,
            ArcChanges* changes, bool refines)
      : map_(map),
        model_(model),
        changes_(changes),
        refines_(refines),
        threads_(settings.threads),
        grid_(grid_memory(), levels, model, settings, map.resolution_m()),
        fan_(map, grid_, map_T_sonar, motion),
        sin_free_(static_cast<float>(grid_.sin_free())) {}

  PingStats run() {
    if (grid_.is_empty()) {
      if (changes_ != nullptr) *changes_ = {};
      return {};
    }
    cells_task_ = grid_.cells_task();
    grid_view_ = grid_.view();
    const double sin_aperture = std::sin(model_.params().half_aperture_rad);
    ends_ = {static_cast<std::int32_t>(grid_.rows()), kMarginBeams + grid_.beams(),
             static_cast<float>(grid_.min_range_m() / grid_.edge_m()),
             static_cast<float>(sin_aperture),
             static_cast<float>(ArcModel::kElevations / sin_aperture)};
    const std::vector<BlockCube> cubes = fan_.cubes();
    fan_.fetch(map_, cubes);
    const WriteLock lock(map_);
    revision_ = map_.next_revision();
    sums_.assign(grid_.size(), 0);
    std::vector<CubeEvidence>& found = evidence_memory();
    if (found.size() < cubes.size()) found.resize(cubes.size());
    for (std::size_t i = 0; i < cubes.size(); ++i) found[i].clear();
    if (refines_) share_changes(cubes.size(), found);
    run_parallel(cubes.size(), threads_, [&](std::size_t i) { look(cubes[i], found[i]); });
    if (refines_) check_changes(cubes.size(), found);
    map_.pool().reserve(cubes.size() * kCubeBlocks * kCubeBlocks * kCubeBlocks * kBlockCells);
    run_parallel(cubes.size(), threads_, [&](std::size_t i) { apply(found[i]); });
    PingStats stats;
    for (std::size_t i = 0; i < cubes.size(); ++i) {
      const CubeEvidence& cube = found[i];
      stats.occupied += cube.stats.occupied;
      stats.free += cube.stats.free;
      stats.blocks_visited += cube.stats.blocks_visited;
      stats.blocks_created += cube.created.size();
      for (const Block& block : cube.created) map_.insert(block);
    }
    if (changes_ != nullptr) collect_changes(cubes.size(), found);
    return stats;
  }

 private:
  void share_changes(std::size_t cubes, std::vector<CubeEvidence>& found) const {
    std::size_t total = 0;
    for (const std::uint32_t count : changes_->counts) total += count;
    if (changes_->counts.size() != cubes || total != changes_->steps.size()) refuse_changes();
    const std::int16_t* from = changes_->steps.data();
    for (std::size_t i = 0; i < cubes; ++i) {
      found[i].earlier = from;
      found[i].earlier_count = changes_->counts[i];
      from += changes_->counts[i];
    }
  }

  static void check_changes(std::size_t cubes, const std::vector<CubeEvidence>& found) {
    for (std::size_t i = 0; i < cubes; ++i) {
      if (found[i].candidates.count != found[i].earlier_count) refuse_changes();
    }
  }

  [[noreturn]] static void refuse_changes() {
    throw std::invalid_argument("the changes are those of another ping");
  }

  void collect_changes(std::size_t cubes, const std::vector<CubeEvidence>& found) const {
    changes_->counts.clear();
    changes_->steps.clear();
    for (std::size_t i = 0; i < cubes; ++i) {
      const Candidates& all = found[i].candidates;
      changes_->counts.push_back(static_cast<std::uint32_t>(all.count));
      const auto end = all.change.begin() + static_cast<std::ptrdiff_t>(all.count);
      changes_->steps.insert(changes_->steps.end(), all.change.begin(), end);
    }
  }

  void look(const BlockCube& cube, CubeEvidence& found) {
    fan_.visit(cube, [&](const BlockCube& block) { look_at_block(block, found); }, 1);
    Candidates& all = found.candidates;
    for (std::size_t first = 0; first < all.count; first += kBatch) {
      const std::size_t end = std::min(all.count, first + kBatch);
      model_.log_misses(all.voxels(first, end), &all.upper[first], &all.lower[first]);
      std::uint32_t high[kBatch], low[kBatch];
      to_words(end - first, &all.weight[first], &all.upper[first], &all.lower[first], high, low);
      for (std::size_t i = first; i < end; ++i) {
        add(sums_[all.arc[i]], std::uint64_t{high[i - first]} << 32 | low[i - first]);
      }
    }
  }

  void add(std::uint64_t& sum, std::uint64_t words) const {
    if (threads_ == 1) {
      sum += words;
    } else {
      __atomic_fetch_add(&sum, words, __ATOMIC_RELAXED);
    }
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
    CellView at;
    if (view.is_linear) {
      const int corner = offset_of_cell(cell);
      const auto from_middle = [](int i) { return i - (kBlockEdge - 1) / 2.0; };
      const Vec3 first = view.seen + from_middle(corner & 15) * view.step[0] +
                         from_middle(corner >> 4 & 15) * view.step[1] +
                         from_middle(corner >> 8) * view.step[2];
      float start[3], step[3][3];
      set(start, first);
      for (std::size_t i = 0; i < 3; ++i) set(step[i], view.step[i]);
      set_linear(start, step, at);
    } else {
      CellPoints points;
      fan_.places_of(view, cell, points);
      const double scale = 1.0 / grid_.edge_m();
      for (std::size_t i = 0; i < kCellVoxels; ++i) {
        at.x[i] = static_cast<float>(scale * points.x[i]);
        at.y[i] = static_cast<float>(scale * points.y[i]);
        at.z[i] = static_cast<float>(scale * points.z[i]);
      }
    }
    set_polar(cells_task_, at);
    if (grid_.is_irregular()) {
      for (int v = 0; v < kCellVoxels; ++v) {
        const double column = grid_.exact_column_of(static_cast<double>(at.sine[v]));
        at.column[v] = static_cast<std::int32_t>(std::clamp(column, -1e6, 1e6));
      }
    }
    set_inside(ends_, at);
    list_voxels(at, block, cell, found);
  }

  void list_voxels(const CellView& at, const Block* block, int cell, CubeEvidence& found) {
    Candidates& all = found.candidates;
    const std::size_t begin = all.count;
    ArcCell record{static_cast<std::uint8_t>(cell), 0, static_cast<std::uint32_t>(begin), 0, {}};
    all.make_room_for_a_cell();
    for (int v = 0; v < kCellVoxels; ++v) {
      if (at.inside[v] == 0) continue;
      const auto row = static_cast<std::size_t>(at.row[v]);
      const std::size_t line = row * static_cast<std::size_t>(grid_view_.stride);
      // Echoes are the same over a group; free space ends at each beam's own first return.
      const std::uint8_t code = grid_.code(line + static_cast<std::size_t>(at.column[v]));
      if (code == kCodeNothing) continue;
      if (code == kCodeFree) {
        if (at.height[v] < sin_free_) {
          record.codes[static_cast<std::size_t>(v)] = kCodeFree;
          ++record.free;
        }
        continue;
      }
      const std::size_t i = all.count++;
      const int beam = at.column[v] - kMarginBeams;
      const int level = (code & ~kBehind) - kCodeOccupied;
      all.arc[i] = static_cast<std::uint32_t>(
          line + static_cast<std::size_t>(kMarginBeams + (beam & grid_.group_masks()[row])));
      all.voxel[i] = static_cast<std::uint8_t>(v | (code & kBehind));
      all.place[i] = ArcModel::place(level, at.elevation[v]);
      all.noise[i] = ArcModel::noise_place(level - grid_.noise_level(at.row[v]));
      all.weight[i] = grid_.weight(at.row[v]);
    }
    if (all.count != begin) {
      DenseCell voxels;
      read_cell(block, cell, voxels);
      for (std::size_t i = begin; i < all.count; ++i) {
        all.units[i] = voxels.units[static_cast<std::size_t>(all.voxel[i] & ~kBehind)];
        all.change[i] = 0;
        if (i < found.earlier_count) {
          all.change[i] = found.earlier[i];
          all.units[i] = map_.rule().clamped(std::int64_t{all.units[i]} - all.change[i]);
        }
      }
    }
    record.end = static_cast<std::uint32_t>(all.count);
    if (record.free != 0 || record.begin != record.end) found.cells.push_back(record);
  }

  void read_cell(const Block* block, int cell, DenseCell& voxels) const {
    if (block != nullptr && block->is_held(cell)) {
      return block->copy_held(map_.rule(), map_.pool(), cell, voxels);
    }
    voxels.units.fill(block != nullptr ? block->alike(map_.rule(), cell).units : Voxel{}.units);
  }

  void find_steps(Candidates& all) const {
    for (std::size_t first = 0; first < all.count; first += kBatch) {
      const std::size_t end = std::min(all.count, first + kBatch);
      for (std::size_t i = first; i < end; ++i) {
        const std::uint64_t sum = sums_[all.arc[i]];
        all.sum_upper[i] = -kSumUnit * static_cast<float>(sum >> 32);
        all.sum_lower[i] = -kSumUnit * static_cast<float>(sum & 0xFFFFFFFFU);
      }
      model_.steps(all.voxels(first, end), &all.upper[first], &all.lower[first],
                   &all.sum_upper[first], &all.sum_lower[first], &all.step[first]);
    }
  }

  void apply(CubeEvidence& cube) {
    find_steps(cube.candidates);
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
      if (!refines_) {
        cube.stats.free +=
            static_cast<std::size_t>(__builtin_popcountll(at.free_cells)) * kCellVoxels;
        changed |= block.add_free(rule, pool, at.free_cells);
      }
      if (changed) block.revision = revision_;
      if (fresh && changed) cube.created.push_back(*fresh);
    }
  }

  bool apply_cell(const ArcCell& at, CubeEvidence& cube, Block& block, CellPool::Cache& pool) {
    const IwloRule& rule = map_.rule();
    if (at.begin == at.end && (refines_ || (block.at_floor() & cell_bit(at.cell)) != 0)) {
      return false;
    }
    const CellVoxels voxels = block.open(rule, pool, at.cell);
    bool changed = false;
    if (at.free != 0 && !refines_) {
      cube.stats.free += at.free;
      changed = kernels_.apply(tables_, at.codes.data(), nullptr, voxels.units(), voxels.counts(),
                               rule.count_bytes());
    }
    for (std::uint32_t i = at.begin; i < at.end; ++i) {
      changed |= apply_candidate(cube.candidates, i, voxels, cube.stats);
    }
    block.close(rule, pool, at.cell);
    return changed;
  }

  bool apply_candidate(Candidates& all, std::size_t i, const CellVoxels& voxels,
                       PingStats& stats) const {
    const int voxel = all.voxel[i] & ~kBehind;
    const std::int16_t before = all.units[i];  // without this ping
    std::int16_t value = before;
    std::uint16_t count = voxels.count(voxel);
    if (const std::optional<std::int32_t> step = step_of(all, i, count)) {
      ++stats.occupied;
      const bool is_counted = all.change[i] != 0;
      map_.rule().add(*step, value, count);
      if (is_counted) count = voxels.count(voxel);
    }
    all.change[i] = static_cast<std::int16_t>(value - before);
    const bool changed = value != voxels.units()[voxel] || count != voxels.count(voxel);
    voxels.units()[voxel] = value;
    voxels.set_count(voxel, count);
    return changed;
  }

  // In units of the map; nothing where the ping says nothing of a voxel.
  std::optional<std::int32_t> step_of(const Candidates& all, std::size_t i,
                                      std::uint16_t count) const {
    const IwloRule& rule = map_.rule();
    const ArcParams& params = model_.params();
    const bool behind = (all.voxel[i] & kBehind) != 0;
    const std::int16_t before = all.units[i];
    float step = all.step[i];
    if (behind && count == 0 && step < static_cast<float>(params.min_step)) return {};
    if (behind && step < 0) {
      if (before <= 0) return {};
      step *= static_cast<float>(params.behind_scale);
    }
    const float scaled = step * static_cast<float>(1 << rule.shift());
    auto units = static_cast<std::int32_t>(scaled + (scaled < 0.0F ? -0.5F : 0.5F));
    if (units < 0 && before > 0) {
      units = -std::int32_t{
          rule.scaled_down(before, static_cast<std::int16_t>(std::min(-units, 32767)))};
      if (behind) units = std::max(units, -std::int32_t{before});
    }
    return units;
  }

  static constexpr std::size_t kBatch = 1024;

  VoxelMap& map_;
  const ArcModel& model_;
  ArcChanges* changes_;
  bool refines_;
  int threads_;
  LevelGrid grid_;
  FanBlocks fan_;
  float sin_free_;
  GridEnds ends_{};
  RuleTables tables_ = map_.rule().tables();
  const Kernels& kernels_ = kernels();
  GridView grid_view_{};
  CellsTask cells_task_{};
  std::vector<std::uint64_t> sums_;  // by arc cell
  std::uint64_t revision_ = 0;
};

PingStats update(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                 const Transform& map_T_sonar, const PingParams& settings, const PingMotion& motion,
                 ArcChanges* changes, bool refines) {
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
  return ArcUpdate(map, model, levels, map_T_sonar, settings, motion, changes, refines).run();
}

}  // namespace

PingStats integrate_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                        const Transform& map_T_sonar, const PingParams& settings,
                        const PingMotion& motion, ArcChanges* changes) {
  return update(map, model, levels, map_T_sonar, settings, motion, changes, false);
}

PingStats refine_arc(VoxelMap& map, const ArcModel& model, const ArcImage& levels,
                     const Transform& map_T_sonar, const PingParams& settings,
                     const PingMotion& motion, ArcChanges& changes) {
  return update(map, model, levels, map_T_sonar, settings, motion, &changes, true);
}

}  // namespace mapperd::map
