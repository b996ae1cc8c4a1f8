// The kernels for this machine and the plain ones give the same bits, and those of the scalar rule.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "mapperd/map/block.hpp"
#include "mapperd/map/kernels.hpp"
#include "rules.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::CellPlaces;
using mapperd::map::CellsTask;
using mapperd::map::CodeCounts;
using mapperd::map::GridTask;
using mapperd::map::GridView;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::kCellVoxels;
using mapperd::map::kCodeFree;
using mapperd::map::kCodeNothing;
using mapperd::map::kCodeOccupied;
using mapperd::map::kernels;
using mapperd::map::Kernels;
using mapperd::map::plain_kernels;
using mapperd::map::Voxel;

TEST_CASE("which kernels this machine runs") {
  std::printf("  %s beside %s\n", kernels().name, plain_kernels().name);
  CHECK(std::string(plain_kernels().name) == "plain");
}

float uniform(scenes::Random& random, double low, double high) {
  return static_cast<float>(random.uniform(low, high));
}

// Rows of returns, of weights 0 to 1, summed up as a grid does.
struct Rows {
  GridTask task{};
  std::vector<float> counted, weighted, free_end, width;

  Rows(scenes::Random& random, double density) {
    task.beams = 8 * random.integer(1, 20);
    task.subcolumns = random.integer(1, 12);
    task.subcolumn = 1.0F / static_cast<float>(task.subcolumns);
    task.ping_rows = random.integer(5, 120);
    const float row_m = uniform(random, 0.01, 0.3);
    task.row_pitch = row_m * uniform(random, 0.2, 3);
    task.half_window = task.row_pitch * uniform(random, 0.5, 4);
    task.rows_per_m = 1 / row_m;
    task.min_range = random.integer(0, 1) == 0 ? 0.0F : row_m * uniform(random, 0, 20);
    task.min_occupied = 0.02F;
    task.min_free = 0.5F;
    const auto beams = static_cast<std::size_t>(task.beams);
    const auto rows = static_cast<std::size_t>(task.ping_rows);
    counted.assign((rows + 1) * beams, 0.0F);
    weighted = counted;
    for (std::size_t i = 0; i < rows * beams; ++i) {
      const bool is_return = random.uniform(0, 1) < density;
      counted[i + beams] = counted[i] + (is_return ? 1.0F : 0.0F);
      weighted[i + beams] = weighted[i] + (is_return ? uniform(random, 0, 1) : 0.0F);
    }
    const double last_m = task.ping_rows * static_cast<double>(row_m);
    for (std::size_t j = 0; j < beams; ++j) {
      free_end.push_back(random.integer(0, 4) == 0 ? 0.0F : uniform(random, 0, last_m));
    }
    for (int group = 0; group < task.beams / 8; ++group) {
      width.push_back(uniform(random, 0.1, 3));
    }
    task.counted = counted.data();
    task.weighted = weighted.data();
    task.free_end = free_end.data();
    task.width = width.data();
    const int columns = (task.beams + 2 * mapperd::map::kMarginBeams) * task.subcolumns;
    task.stride = (columns + 31) / 32 * 32;
    task.tile_stride = task.stride / mapperd::map::kTileColumns;
  }
};

struct Built {
  std::vector<std::uint8_t> codes, shares, classes;

  Built(const Kernels& with, GridTask task, int rows, bool averages, int dirt) {
    const auto size = static_cast<std::size_t>(task.stride * rows);
    codes.assign(size, static_cast<std::uint8_t>(dirt));
    shares.assign(size, 0);
    classes.assign(size, static_cast<std::uint8_t>(dirt));
    std::vector<float> scratch(scratch_floats(task), static_cast<float>(dirt));
    task.codes = codes.data();
    task.shares = averages ? shares.data() : nullptr;
    task.classes = classes.data();
    with.build_rows(task, 0, rows, scratch.data());
    classes.resize(static_cast<std::size_t>(rows / mapperd::map::kTileRows * task.tile_stride));
  }
};

TEST_CASE("rows of the grid, to the bit, whatever the memory held before") {
  scenes::Random random(201);
  std::size_t occupied = 0, free = 0;
  for (int i = 0; i < (kSanitized ? 20 : 150); ++i) {
    const Rows rows(random, i % 3 == 0 ? 0.0 : random.uniform(0, 0.1));
    const bool averages = i % 4 == 1;
    const Built fast(kernels(), rows.task, 64, averages, 0);
    const Built plain(plain_kernels(), rows.task, 64, averages, 77);
    CHECK(fast.codes == plain.codes);
    CHECK(fast.classes == plain.classes);
    for (std::size_t at = 0; averages && at < fast.codes.size(); ++at) {
      if (fast.codes[at] >= kCodeOccupied) CHECK(fast.shares[at] == plain.shares[at]);
    }
    // Each tile's mask is that of its codes.
    constexpr std::uint8_t kOf[] = {mapperd::map::kHasNothing, mapperd::map::kHasFree};
    std::vector<std::uint8_t> classes(plain.classes.size(), 0);
    for (std::size_t at = 0; at < plain.codes.size(); ++at) {
      const auto stride = static_cast<std::size_t>(rows.task.stride);
      const std::uint8_t code = plain.codes[at];
      occupied += code >= kCodeOccupied ? 1U : 0U;
      free += code == kCodeFree ? 1U : 0U;
      classes[at / stride / mapperd::map::kTileRows *
                  static_cast<std::size_t>(rows.task.tile_stride) +
              at % stride / mapperd::map::kTileColumns] |=
          code < kCodeOccupied ? kOf[code] : mapperd::map::kHasOccupied;
    }
    CHECK(classes == plain.classes);
  }
  CHECK((kSanitized || (occupied > 100000 && free > 100000)));
}

struct RandomGrid {
  std::vector<std::uint8_t> codes, shares, classes;
  GridView view{};

  explicit RandomGrid(scenes::Random& random) {
    const int rows = 16 * random.integer(2, 10), columns = random.integer(70, 400);
    view.stride = (columns + 31) / 32 * 32;
    view.tile_stride = view.stride / mapperd::map::kTileColumns;
    view.rows = static_cast<float>(rows);
    view.columns = static_cast<float>(columns);
    codes.resize(static_cast<std::size_t>(rows * view.stride));
    shares.resize(codes.size());
    classes.resize(codes.size());
    for (std::uint8_t& code : codes) {
      code = static_cast<std::uint8_t>(std::max(random.integer(-200, 255), random.integer(0, 1)));
    }
    for (std::uint8_t& share : shares) share = static_cast<std::uint8_t>(random.integer(0, 255));
    for (std::uint8_t& mask : classes) mask = static_cast<std::uint8_t>(random.integer(1, 7));
    view.codes = codes.data();
    view.shares = shares.data();
    view.cell_classes = classes.data();
  }
};

// Where the cells of a block lie, and a table of bearings.
struct RandomCells {
  CellsTask task{};
  std::vector<float> columns, slopes;
  mapperd::Vec3 first;  // cell's centre
  mapperd::Vec3 step[3];

  RandomCells(scenes::Random& random, const GridView& grid) {
    const mapperd::Transform pose = scenes::random_pose(random);
    const double far = random.integer(0, 4) == 0 ? 5 : 60;
    first = {random.uniform(-0.2 * far, far), random.uniform(-far, far),
             random.uniform(-0.3 * far, 0.3 * far)};
    const mapperd::Vec3 axes[] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    set(task.first, first);
    for (int axis = 0; axis < 3; ++axis) {
      step[axis] = pose.rotate_back(axes[axis]);
      set(task.step[axis], 4 * step[axis]);
      set(task.voxel_step[axis], step[axis]);
    }
    const double half = random.uniform(0.05, 0.8);
    task.sin_half_aperture = static_cast<float>(std::sin(half));
    task.cos_half_aperture = static_cast<float>(std::cos(half));
    task.rows_per_voxel =
        static_cast<float>(random.uniform(0.4, 1.1) * static_cast<double>(grid.rows) / far);
    task.reach = 2.65F;
    const int bins = random.integer(1, 300);
    const double width = random.uniform(0.2, 2);
    task.sine_low = uniform(random, -1, 0);
    const double slope = static_cast<double>(grid.columns) / width;
    for (int bin = 0; bin < bins; ++bin) {
      slopes.push_back(static_cast<float>(slope * random.uniform(0.9, 1.1)));
      columns.push_back(
          static_cast<float>(-slope * static_cast<double>(task.sine_low) + random.uniform(-1, 1)));
    }
    task.bins_per_sine = static_cast<float>(bins / width);
    task.last_bin = static_cast<float>(bins) - 0.5F;
    task.bin_column = columns.data();
    task.bin_slope = slopes.data();
  }

  // The codes of a cell's voxels in double precision, kUnsure where single precision may differ.
  static constexpr int kUnsure = -1;
  std::array<int, kCellVoxels> codes(const RandomGrid& grid, int cell, unsigned classes) const {
    const mapperd::Vec3 c =
        first + 4.0 * (double(cell % 4) * step[0] + double(cell / 4 % 4) * step[1] +
                       double(cell / 16) * step[2]);
    const double flat = std::hypot(c.x, c.y), range = norm(c), sine = -c.y / flat;
    const double bin = std::clamp((sine - double(task.sine_low)) * double(task.bins_per_sine), 0.0,
                                  double(task.last_bin));
    std::array<int, kCellVoxels> found{};
    found.fill(kUnsure);
    if (near_whole(bin, 1e-3)) return found;
    const double slope = double(slopes[static_cast<std::size_t>(bin)]);
    const double column = double(columns[static_cast<std::size_t>(bin)]) + slope * sine;
    for (int v = 0; v < kCellVoxels; ++v) {
      const mapperd::Vec3 d =
          (v % 4 - 1.5) * step[0] + (v / 4 % 4 - 1.5) * step[1] + (v / 16 - 1.5) * step[2];
      const double along = dot(c, d) / range;
      const double across = (c.y * (c.x * d.x + c.y * d.y) / (flat * flat) - d.y) / flat;
      const double row = std::clamp((range + along) * double(task.rows_per_voxel), 0.0,
                                    double(grid.view.rows) - 0.5);
      const double at = std::clamp(column + slope * across, 0.0, double(grid.view.columns) - 0.5);
      const double inside =
          (flat + (c.x * d.x + c.y * d.y) / flat) * double(task.sin_half_aperture) -
          std::abs(c.z + d.z) * double(task.cos_half_aperture);
      if (near_whole(row, 2e-3) || near_whole(at, 2e-3) || std::abs(inside) < 1e-4 ||
          std::abs(inside + 0.5) < 1e-4) {
        continue;
      }
      const bool all_free =
          (classes & (mapperd::map::kHasNothing | mapperd::map::kHasOccupied)) == 0;
      int code = all_free ? kCodeFree
                          : grid.codes[static_cast<std::size_t>(
                                static_cast<int>(row) * grid.view.stride + static_cast<int>(at))];
      const bool cut = (classes & mapperd::map::kCutByAperture) != 0;
      if (cut && (code >= kCodeOccupied ? inside <= -0.5 : inside <= 0)) code = kCodeNothing;
      found[static_cast<std::size_t>(v)] = code;
    }
    return found;
  }

 private:
  static void set(float* to, const mapperd::Vec3& v) {
    to[0] = static_cast<float>(v.x);
    to[1] = static_cast<float>(v.y);
    to[2] = static_cast<float>(v.z);
  }
  static bool near_whole(double x, double tolerance) {
    return std::abs(x - std::round(x)) < tolerance;
  }
};

TEST_CASE("look-ups of a block's voxels, to the bit, and those of double precision") {
  scenes::Random random(220);
  long compared = 0, known = 0;
  for (int turn = 0; turn < (kSanitized ? 50 : 1500); ++turn) {
    const RandomGrid grid(random);
    const RandomCells cells(random, grid.view);
    CellPlaces fast, plain;
    std::memset(&fast, 0, sizeof fast);
    std::memset(&plain, 0, sizeof plain);
    kernels().place_cells(cells.task, grid.view, fast);
    plain_kernels().place_cells(cells.task, grid.view, plain);
    CHECK(std::memcmp(&fast, &plain, sizeof fast) == 0);
    for (int cell = 0; cell < 64; ++cell) {
      const unsigned classes = plain.classes[cell];
      if (classes == 0 || classes == mapperd::map::kHasFree) continue;
      std::array<std::uint8_t, 64> codes{}, plain_codes{}, shares{}, plain_shares{};
      const bool averages = random.integer(0, 1) == 1;
      const CodeCounts a = kernels().look_up(cells.task, grid.view, fast, cell, codes.data(),
                                             averages ? shares.data() : nullptr);
      const CodeCounts b =
          plain_kernels().look_up(cells.task, grid.view, plain, cell, plain_codes.data(),
                                  averages ? plain_shares.data() : nullptr);
      CHECK((codes == plain_codes && shares == plain_shares));
      CHECK((a.occupied == b.occupied && a.free == b.free));
      CHECK(b.free == std::count(codes.begin(), codes.end(), kCodeFree));
      CHECK(b.occupied == std::count_if(codes.begin(), codes.end(),
                                        [](std::uint8_t code) { return code >= kCodeOccupied; }));
      const auto expected = cells.codes(grid, cell, classes);
      for (std::size_t v = 0; v < 64; ++v) {
        if (expected[v] == RandomCells::kUnsure) continue;
        ++compared;
        known += expected[v] != kCodeNothing ? 1 : 0;
        CHECK(codes[v] == expected[v]);
      }
    }
  }
  CHECK((kSanitized || (compared > 100000 && known > 20000)));
}

// A cell's voxels, as the pool holds them.
struct Cell {
  std::array<std::int16_t, kCellVoxels> units{};
  std::array<std::uint16_t, kCellVoxels> counts{};

  void set_count(int bytes, int v, std::uint16_t count) {
    auto* const raw = reinterpret_cast<std::byte*>(counts.data());
    if (bytes == 2) counts[static_cast<std::size_t>(v)] = count;
    if (bytes == 1) raw[v] = static_cast<std::byte>(count);
  }
  std::uint16_t count(int bytes, int v) const {
    const auto* const raw = reinterpret_cast<const std::uint8_t*>(counts.data());
    return bytes == 2 ? counts[static_cast<std::size_t>(v)] : raw[v];
  }
  bool operator==(const Cell& other) const {
    return units == other.units && counts == other.counts;
  }
};

// The rule of iwlo.hpp, one voxel at a time; a share of 256ths where evidence is averaged.
Voxel stepped(const IwloRule& rule, Voxel voxel, std::uint8_t code, const std::uint8_t* share) {
  if (code == kCodeNothing) return voxel;
  if (code == kCodeFree) {
    rule.add_free(voxel.units, voxel.count);
    return voxel;
  }
  std::int64_t step = rule.occupied_units(voxel.units, voxel.count, rule.full_step_of_code(code));
  if (share != nullptr) {
    const auto part = static_cast<std::int16_t>((*share << 7) + (*share >> 1));
    const auto rest = static_cast<std::int16_t>(32767 - part);
    const std::int16_t down = rule.free_units(voxel.units, voxel.count);
    step = mapperd::map::multiply_q15(static_cast<std::int16_t>(step), part) -
           mapperd::map::multiply_q15(down, rest);
  }
  rule.add(step, voxel.units, voxel.count);
  return voxel;
}

struct Tally {
  long voxels = 0;
  long changed = 0;
};

void check_apply(const IwloRule& rule, const Cell& before,
                 const std::array<std::uint8_t, kCellVoxels>& codes,
                 const std::array<std::uint8_t, kCellVoxels>* shares, Tally& tally) {
  const int bytes = rule.count_bytes();
  Cell expected = before;
  bool changes = false;
  for (int v = 0; v < kCellVoxels; ++v) {
    const auto at = static_cast<std::size_t>(v);
    const Voxel was{before.units[at], before.count(bytes, v)};
    const Voxel now = stepped(rule, was, codes[at], shares == nullptr ? nullptr : &(*shares)[at]);
    expected.units[at] = now.units;
    expected.set_count(bytes, v, now.count);
    changes = changes || !(was == now);
    ++tally.voxels;
    tally.changed += was == now ? 0 : 1;
  }
  for (const Kernels* each : {&kernels(), &plain_kernels()}) {
    Cell cell = before;
    const bool changed =
        each->apply(rule.tables(), codes.data(), shares == nullptr ? nullptr : shares->data(),
                    cell.units.data(), reinterpret_cast<std::byte*>(cell.counts.data()), bytes);
    CHECK(cell == expected);
    CHECK(changed == changes);
  }
}

TEST_CASE("updates of a cell are those of the scalar rule, in every state") {
  scenes::Random random(230);
  for (const IwloParams& params : rules::extreme()) {
    const IwloRule rule(params);
    const int settled = rule.settled_count();
    Tally tally;
    // All log-odds of a coarse grid and near the limits, at the counts where alpha begins, ends and
    // in between, with every code.
    std::vector<std::int16_t> levels;
    for (int units = rule.min_units(); units <= rule.max_units(); units += 97) {
      levels.push_back(static_cast<std::int16_t>(units));
    }
    for (int i = 0; i < 200; ++i) levels.push_back(rules::random_units(rule, random));
    const int counts[] = {0, 1, 2, settled / 2, settled - 1, settled};
    for (const int seen : counts) {
      if (seen < 0 || seen > settled) continue;
      for (const bool alike : {true, false}) {  // counts
        Cell cell;
        std::array<std::uint8_t, kCellVoxels> codes{}, shares{};
        int v = 0;
        for (const std::int16_t units : levels) {
          const auto at = static_cast<std::size_t>(v);
          const int kind = random.integer(0, 5);
          cell.units[at] = units;
          cell.set_count(
              rule.count_bytes(), v,
              alike ? static_cast<std::uint16_t>(seen) : rules::random_count(rule, random));
          codes[at] = static_cast<std::uint8_t>(kind < 2 ? kind : random.integer(2, 255));
          shares[at] = static_cast<std::uint8_t>(
              random.integer(0, 3) == 0 ? 255 * random.integer(0, 1) : random.integer(0, 255));
          if (++v < kCellVoxels) continue;
          v = 0;
          check_apply(rule, cell, codes, nullptr, tally);
          check_apply(rule, cell, codes, &shares, tally);
          for (const std::uint8_t all : {kCodeNothing, kCodeFree, kCodeOccupied}) {
            codes.fill(all);
            check_apply(rule, cell, codes, nullptr, tally);
          }
        }
      }
    }
    CHECK((tally.voxels > 2000 && tally.changed > tally.voxels / 10));
  }
}

TEST_CASE("averaged evidence of both kinds lies between them") {
  const IwloRule rule{IwloParams{}};
  for (int share = 0; share <= 255; ++share) {
    const auto part = static_cast<std::uint8_t>(share);
    for (const int units : {-8000, -1, 0, 3000}) {
      const Voxel was{static_cast<std::int16_t>(units), 4};
      const Voxel mean = stepped(rule, was, 200, &part);
      const Voxel up = stepped(rule, was, 200, nullptr),
                  down = stepped(rule, was, kCodeFree, nullptr);
      const double exact =
          units + (share * (up.units - units) + (255 - share) * (down.units - units)) / 255.0;
      // A share of 255ths is made one of 2^15 by shifts, off by 1 / 500; each product is rounded.
      CHECK(mean.units == near(exact, 1.0 + (up.units - down.units) / 256.0));
    }
  }
}

}  // namespace
