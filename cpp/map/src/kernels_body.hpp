// The kernels' text, included once a target; MAPPERD_KERNELS names the target's namespace.
// Nothing but plain data and vectors of it: see kernels.hpp.
#include "lanes_body.hpp"
#include "mapperd/map/kernels.hpp"

namespace mapperd::map {
namespace MAPPERD_KERNELS {
namespace {

// One row of the grid: evidence by beam, then over the footprint's width.
class RowBuilder {
 public:
  RowBuilder(const GridTask& task, float* scratch)
      : task_(task), groups_(task.beams / kGroupBeams) {
    const std::ptrdiff_t pad = task.beams + 2 * kMarginBeams + 3 * kGroupBeams;
    const std::ptrdiff_t size = task.beams + 2 * pad;
    __builtin_memset(scratch, 0, 3 * static_cast<std::size_t>(size) * sizeof(float));
    returns_ = scratch + pad;
    weights_ = returns_ + size;
    free_ = weights_ + size;
    sum_returns_ = free_ + size;
    sum_weights_ = sum_returns_ + size;
    sum_free_ = sum_weights_ + size;
    flags_ = reinterpret_cast<std::uint8_t*>(sum_free_ + task.beams + pad);
  }

  void build(int row) {
    range_ = (static_cast<float>(row) + 0.5F) * task_.row_pitch;
    place_ = row * task_.stride;
    filled_ = 0;
    fill_code_ = kCodeNothing;
    if ((sum_along_range() & (kHasOccupied | kHasFree)) != 0) {
      write(-kMarginBeams, 0);
      for (int group = 0; group < groups_; ++group) write(group * kGroupBeams, group);
      write(task_.beams, groups_ - 1);
    }
    const std::ptrdiff_t end = std::ptrdiff_t{task_.beams + 2 * kMarginBeams} * task_.subcolumns;
    if (fill_code_ != kCodeNothing) fill_up_to(end);
    fill_code_ = kCodeNothing;
    fill_up_to(task_.stride);
    // The outermost columns stand for all that is farther beside the fan.
    task_.codes[place_] = task_.codes[place_ + end - 1] = kCodeNothing;
  }

 private:
  // Shares of the footprint's depth that hold returns or are free, beam by beam.
  std::uint8_t sum_along_range() {
    const float near = larger(range_ - task_.half_window, task_.min_range);
    const float far = range_ + task_.half_window;
    const float depth = 2 * task_.half_window;
    const auto last = static_cast<float>(task_.ping_rows);
    const float low = smaller(near * task_.rows_per_m, last);
    const float high = larger(smaller(far * task_.rows_per_m, last), low);
    const int low_row = row_at(low), high_row = row_at(high);
    const float low_part = low - static_cast<float>(low_row);
    const float high_part = high - static_cast<float>(high_row);
    const float scale = 1.0F / (depth * task_.rows_per_m);
    const float per_depth = 1.0F / depth;
    // Beams that are free up to here are so over the footprint's whole depth.
    const float whole = near > range_ - task_.half_window ? 1e30F : far;
    const auto at = [&](const float* sums, int r, int beam) {
      return load<F8>(sums + std::ptrdiff_t{r} * task_.beams + beam);
    };
    std::uint8_t found = 0;
    for (int group = 0; group < groups_; ++group) {
      const int beam = group * kGroupBeams;
      std::uint8_t flags = 0;
      F8 returns{}, weights{};
      if (high > low &&
          any(at(task_.counted, low_row, beam) != at(task_.counted, high_row + 1, beam))) {
        const auto between = [&](const float* sums) {
          const F8 l0 = at(sums, low_row, beam), l1 = at(sums, low_row + 1, beam);
          const F8 h0 = at(sums, high_row, beam), h1 = at(sums, high_row + 1, beam);
          return ((h0 - l0) + ((h1 - h0) * high_part - (l1 - l0) * low_part)) * scale;
        };
        returns = between(task_.counted);
        weights = between(task_.weighted);
        flags |= kHasOccupied;
      }
      const F8 end = load<F8>(task_.free_end + beam);
      const F8 some = larger(smaller(end, all(far)) - near, F8{}) * per_depth;
      const F8 free = end >= whole ? all(1.0F) : some;
      if (any(free > 0.0F)) flags |= kHasFree;
      if (any(free < 1.0F)) flags |= kHasNothing;
      store(returns, returns_ + beam);
      store(weights, weights_ + beam);
      store(free, free_ + beam);
      flags_[group] = flags;
      found |= flags;
    }
    return found;
  }

  int row_at(float row) const {
    const int whole = static_cast<int>(row);
    return whole < task_.ping_rows ? whole : task_.ping_rows - 1;
  }

  // Half of the footprint in beams.
  float half_width(int group) const { return task_.width[group] / range_; }
  // What of it may lie in the fan, seen from anywhere.
  float half_in_fan(int group) const {
    return smaller(half_width(group), static_cast<float>(task_.beams + kMarginBeams));
  }

  // Sums of the beams from `first` to before each beam up to `end`; nothing lies beyond the fan.
  void sum_over_beams(const float* values, int first, int end, float* sums) const {
    sums[first] = 0;
    F8 before{};
    for (int beam = first; beam < end; beam += 8) {
      F8 sum = load<F8>(values + beam);
      sum += MAPPERD_SHUFFLE(F8{}, sum, 0, 8, 9, 10, 11, 12, 13, 14);
      sum += MAPPERD_SHUFFLE(F8{}, sum, 0, 0, 8, 9, 10, 11, 12, 13);
      sum += MAPPERD_SHUFFLE(F8{}, sum, 0, 0, 0, 0, 8, 9, 10, 11);
      sum += before;
      store(sum, sums + beam + 1);
      before = all(sum[7]);
    }
  }

  std::uint8_t flags_near(int beam, int reach) const {
    const int first = beam - reach, end = beam + kGroupBeams + reach;
    if (first >= 0 && end <= task_.beams && reach <= kGroupBeams) {
      const std::uint8_t* const flags = flags_ + beam / kGroupBeams;
      return static_cast<std::uint8_t>(flags[-1] | flags[0] | flags[1]);
    }
    std::uint8_t flags = first < 0 || end > task_.beams ? kHasNothing : 0;
    const int last_group = end >= task_.beams ? groups_ - 1 : (end - 1) / kGroupBeams;
    for (int g = first < 0 ? 0 : first / kGroupBeams; g <= last_group; ++g) flags |= flags_[g];
    return flags;
  }

  // Writes one code from the last column on.
  void fill_up_to(std::ptrdiff_t column) {
    if (column > filled_) {
      __builtin_memset(task_.codes + place_ + filled_, fill_code_,
                       static_cast<std::size_t>(column - filled_));
    }
    filled_ = column;
  }

  // The columns of eight beams, by the width of a group.
  void write(int beam, int group) {
    const float half = half_in_fan(group);
    const int reach = static_cast<int>(half) + 2;
    const std::ptrdiff_t column = std::ptrdiff_t{beam + kMarginBeams} * task_.subcolumns;
    const std::ptrdiff_t columns = std::ptrdiff_t{kGroupBeams} * task_.subcolumns;
    const std::uint8_t flags = flags_near(beam, reach);
    if ((flags & kHasOccupied) == 0) {
      const bool none = (flags & kHasFree) == 0;
      if (none || (flags & kHasNothing) == 0) {
        const std::uint8_t code = none ? kCodeNothing : kCodeFree;
        if (code != fill_code_) fill_up_to(column);
        fill_code_ = code;
        return;
      }
    }
    fill_up_to(column);
    filled_ = column + columns;
    const int first = beam - reach, end = beam + kGroupBeams + reach;
    const bool any_free = (flags & kHasFree) != 0;
    if (any_free) sum_over_beams(free_, first, end, sum_free_);
    if ((flags & kHasOccupied) != 0) {
      sum_over_beams(returns_, first, end, sum_returns_);
      sum_over_beams(weights_, first, end, sum_weights_);
    }
    const float footprint = 2 * half_width(group);
    std::uint64_t codes[kMaxSubcolumns], shares[kMaxSubcolumns];
    for (int phase = 0; phase < task_.subcolumns; ++phase) {
      const float middle = (static_cast<float>(phase) + 0.5F) * task_.subcolumn;
      const Window window(beam, middle - half, middle + half);
      const F8 free = any_free ? window.over(sum_free_) : F8{};
      const I8 other = free > task_.min_free * footprint ? I8{} + kCodeFree : I8{};
      if ((flags & kHasOccupied) == 0) {
        codes[phase] = bytes_of(other);
        shares[phase] = 0;
        continue;
      }
      const F8 returns = window.over(sum_returns_);
      const F8 weights = window.over(sum_weights_);
      const I8 occupied = returns >= task_.min_occupied * footprint;
      const F8 weight = smaller(larger(weights / larger(returns, all(1e-12F)), F8{}), all(1.0F));
      const I8 code = kCodeOccupied + truncated(weight * (255.0F - kCodeOccupied) + 0.5F);
      codes[phase] = bytes_of(occupied ? code : other);
      if (task_.shares == nullptr) continue;
      const F8 seen = larger(returns + larger(free, F8{}), all(1e-12F));
      shares[phase] = bytes_of(truncated(smaller(returns / seen, all(1.0F)) * 255.0F + 0.5F));
    }
    interleave(codes, task_.codes + place_ + column);
    if (task_.shares != nullptr) interleave(shares, task_.shares + place_ + column);
  }

  // From one beam's lower place to its upper place, and the same for its seven neighbours.
  class Window {
   public:
    Window(int beam, float low, float high)
        : low_beam_(beam + floored(low)),
          high_beam_(beam + floored(high)),
          low_part_(low - static_cast<float>(floored(low))),
          high_part_(high - static_cast<float>(floored(high))) {}

    F8 over(const float* sums) const {
      const F8 l0 = load<F8>(sums + low_beam_), l1 = load<F8>(sums + low_beam_ + 1);
      const F8 h0 = load<F8>(sums + high_beam_), h1 = load<F8>(sums + high_beam_ + 1);
      return (h0 - l0) + ((h1 - h0) * high_part_ - (l1 - l0) * low_part_);
    }

   private:
    static int floored(float a) {
      const int whole = static_cast<int>(a);
      return static_cast<float>(whole) > a ? whole - 1 : whole;
    }

    int low_beam_;
    int high_beam_;
    float low_part_;
    float high_part_;
  };

  // Columns of eight beams from bytes by phase.
  void interleave(const std::uint64_t* phases, std::uint8_t* columns) const {
    const int count = task_.subcolumns;
    if (count == 1) {
      __builtin_memcpy(columns, phases, 8);
      return;
    }
#if defined(__AVX2__)
    if (count == 2) {
      const __m128i low = _mm_cvtsi64_si128(static_cast<long long>(phases[0]));
      const __m128i high = _mm_cvtsi64_si128(static_cast<long long>(phases[1]));
      store(_mm_unpacklo_epi8(low, high), columns);
      return;
    }
#endif
    for (int phase = 0; phase < count; ++phase) {
      std::uint64_t bytes = phases[phase];
      for (int i = 0; i < kGroupBeams; ++i, bytes >>= 8) {
        columns[i * count + phase] = static_cast<std::uint8_t>(bytes);
      }
    }
  }

  const GridTask& task_;
  int groups_;
  float range_ = 0;
  std::ptrdiff_t place_ = 0;               // of the row
  std::ptrdiff_t filled_ = 0;              // columns of the row that are written
  std::uint8_t fill_code_ = kCodeNothing;  // of those after them
  float* returns_;
  float* weights_;
  float* free_;
  float* sum_returns_;
  float* sum_weights_;
  float* sum_free_;
  std::uint8_t* flags_;
};

static_assert(kTileRows == 4 && kTileColumns == 4);

void find_classes(const GridTask& task, int first_row) {
  std::uint8_t* classes = task.classes + first_row / kTileRows * task.tile_stride;
  for (std::ptrdiff_t column = 0; column < task.stride; column += 16) {
    B16 found{};
    for (int row = 0; row < kTileRows; ++row) {
      const auto codes = load<B16>(task.codes + (first_row + row) * task.stride + column);
      const B16 nothing = reinterpret_cast<B16>(codes == kCodeNothing) & kHasNothing;
      const B16 free = reinterpret_cast<B16>(codes == kCodeFree) & kHasFree;
      const B16 occupied = reinterpret_cast<B16>(codes >= kCodeOccupied) & kHasOccupied;
      found |= nothing | free | occupied;
    }
    using Words = Vector<std::uint32_t, 4>;
    Words words = reinterpret_cast<Words>(found);
    words |= words >> 16;
    words |= words >> 8;
    store(__builtin_convertvector(words, Vector<std::uint8_t, 4>), classes + column / 4);
  }
}

void build_rows(const GridTask& task, int first, int end, float* scratch) {
  RowBuilder builder(task, scratch);
  for (int row = first; row < end; ++row) {
    builder.build(row);
    if ((row + 1) % kTileRows == 0) find_classes(task, row + 1 - kTileRows);
  }
}

constexpr F8 kPlaceX{0, 1, 2, 3, 0, 1, 2, 3};
constexpr F8 kPlaceY{0, 0, 0, 0, 1, 1, 1, 1};

// A linear function at eight neighbours of a cube of 4 x 4 x 4.
class Line {
 public:
  Line(float first, const float* step)
      : half_{first + kPlaceX * step[0] + kPlaceY * step[1], {}}, up_(all(step[2])) {
    half_[1] = half_[0] + 2 * step[1];
  }
  // To be asked for i = 0 to 7 in turn.
  F8 operator()(int i) {
    const F8 value = half_[i & 1];
    half_[i & 1] = value + up_;
    return value;
  }

 private:
  F8 half_[2];
  F8 up_;
};

void place_cells(const CellsTask& task, const GridView& grid, CellPlaces& places) {
  const float of_x[3] = {task.step[0][0], task.step[1][0], task.step[2][0]};
  const float of_y[3] = {task.step[0][1], task.step[1][1], task.step[2][1]};
  const float of_z[3] = {task.step[0][2], task.step[1][2], task.step[2][2]};
  Line ahead(task.first[0], of_x), port(task.first[1], of_y), up(task.first[2], of_z);
  const I8 last_column = I8{} + (static_cast<std::int32_t>(grid.columns) - 1);
  const I8 last_row = I8{} + (static_cast<std::int32_t>(grid.rows) - 1);
  for (int i = 0; i < 8; ++i) {
    const F8 x = ahead(i), y = port(i), z = up(i);
    const F8 flat = x * x + y * y;
    const F8 horizontal = root(flat) + 1e-20F;
    const F8 range = root(flat + z * z);
    const F8 sine = -y / horizontal;
    const F8 bin =
        smaller(larger((sine - task.sine_low) * task.bins_per_sine, F8{}), all(task.last_bin));
    const I8 bins = truncated(bin);
    F8 column, slope;
    for (int k = 0; k < 8; ++k) {
      column[k] = task.bin_column[bins[k]];
      slope[k] = task.bin_slope[bins[k]];
    }
    column += slope * sine;
    const I8 rows = smaller(truncated(smaller(range * task.rows_per_voxel, all(1e6F))), last_row);
    const I8 columns = smaller(
        larger(truncated(smaller(larger(column, all(-1e6F)), all(1e6F))), I8{}), last_column);
    const I8 tiles = (rows / kTileRows) * grid.tile_stride + columns / kTileColumns;
    I8 classes;
    for (int k = 0; k < 8; ++k) classes[k] = grid.cell_classes[tiles[k]];
    const F8 height = absolute(z);
    const F8 inside = horizontal * task.sin_half_aperture - height * task.cos_half_aperture;
    const I8 occupied = (classes & kHasOccupied) != 0;
    const F8 slack = occupied ? all(-0.5F - task.reach) : all(-task.reach);
    const I8 nothing = (classes == kHasNothing) | (inside < slack) | (x < -task.reach);
    classes |= inside < task.reach ? I8{} + kCutByAperture : I8{};
    classes |= x < task.reach ? I8{} + kNearAxis : I8{};
    classes = nothing ? I8{} : classes;
    for (int k = 0; k < 8; ++k) places.classes[8 * i + k] = static_cast<std::uint8_t>(classes[k]);
    if (!any((classes != 0) & (classes != kHasFree))) continue;
    // Where the cells' first voxels lie, and by how much that changes from voxel to voxel.
    const F8 row_scale = task.rows_per_voxel / range;
    const F8 cosine = x / horizontal;
    const F8 turn = -slope * cosine / horizontal;
    F8 row_step = F8{}, column_step = F8{}, spread_step = F8{}, height_step = F8{};
    for (int axis = 0; axis < 3; ++axis) {
      const float* const step = task.voxel_step[axis];
      const F8 in_rows = row_scale * (x * step[0] + y * step[1] + z * step[2]);
      const F8 in_columns = turn * (sine * step[0] + cosine * step[1]);
      const F8 in_spread = task.sin_half_aperture * (cosine * step[0] - sine * step[1]);
      row_step += in_rows;
      column_step += in_columns;
      spread_step += in_spread;
      height_step += task.cos_half_aperture * step[2];
      store(in_rows, places.row_step[axis] + 8 * i);
      store(in_columns, places.column_step[axis] + 8 * i);
      store(in_spread, places.spread_step[axis] + 8 * i);
    }
    store(range, places.range + 8 * i);
    const F8 row = range * task.rows_per_voxel;
    store(row - 1.5F * row_step, places.row + 8 * i);
    store(column - 1.5F * column_step, places.column + 8 * i);
    store(horizontal * task.sin_half_aperture - 1.5F * spread_step, places.spread + 8 * i);
    store(z * task.cos_half_aperture - 1.5F * height_step, places.height + 8 * i);
    const F8 wide = absolute(turn) * task.reach + 1.0F;
    const float deep = task.reach * task.rows_per_voxel + 1.0F;
    const I8 within =
        (row > deep) & (row < grid.rows - deep) & (column > wide) & (column < grid.columns - wide);
    for (int k = 0; k < 8; ++k) places.within[8 * i + k] = within[k] != 0;
  }
}

CodeCounts count_codes(const std::uint8_t* codes) {
  B16 occupied{}, free{};
  for (int i = 0; i < 64; i += 16) {
    const auto code = load<B16>(codes + i);
    occupied -= reinterpret_cast<B16>(code >= kCodeOccupied);
    free -= reinterpret_cast<B16>(code == kCodeFree);
  }
  const auto sum = [](B16 counts) {
    const auto words = reinterpret_cast<Vector<std::uint64_t, 2>>(counts);
    return static_cast<int>((words[0] + words[1]) * 0x0101010101010101U >> 56);
  };
  return {sum(occupied), sum(free)};
}

// Sixteen bytes of a table, gathered in one register: a later load need not wait for sixteen
// stores.
inline B16 sixteen(const std::uint8_t* table, const std::int32_t* at) {
#if defined(__AVX2__)
  __m128i low = _mm_cvtsi32_si128(table[at[0]]), high = _mm_setzero_si128();
  low = _mm_insert_epi8(low, table[at[1]], 1);
  high = _mm_insert_epi8(high, table[at[8]], 8);
  low = _mm_insert_epi8(low, table[at[2]], 2);
  high = _mm_insert_epi8(high, table[at[9]], 9);
  low = _mm_insert_epi8(low, table[at[3]], 3);
  high = _mm_insert_epi8(high, table[at[10]], 10);
  low = _mm_insert_epi8(low, table[at[4]], 4);
  high = _mm_insert_epi8(high, table[at[11]], 11);
  low = _mm_insert_epi8(low, table[at[5]], 5);
  high = _mm_insert_epi8(high, table[at[12]], 12);
  low = _mm_insert_epi8(low, table[at[6]], 6);
  high = _mm_insert_epi8(high, table[at[13]], 13);
  low = _mm_insert_epi8(low, table[at[7]], 7);
  high = _mm_insert_epi8(high, table[at[14]], 14);
  high = _mm_insert_epi8(high, table[at[15]], 15);
  return reinterpret_cast<B16>(_mm_or_si128(low, high));
#else
  std::uint8_t bytes[16];
  for (int i = 0; i < 16; ++i) bytes[i] = table[at[i]];
  return load<B16>(bytes);
#endif
}

inline void take(const std::uint8_t* table, const std::int32_t* at, std::uint8_t* values) {
  for (int i = 0; i < 64; i += 16) store(sixteen(table, at + i), values + i);
}

CodeCounts look_up(const CellsTask& task, const GridView& grid, const CellPlaces& places, int cell,
                   std::uint8_t* codes, std::uint8_t* shares) {
  const auto line = [cell](const float* first, const float (*step)[64]) {
    const float steps[3] = {step[0][cell], step[1][cell], step[2][cell]};
    return Line(first[cell], steps);
  };
  const unsigned classes = places.classes[cell];
  if ((classes & (kHasNothing | kHasOccupied)) == 0) {
    __builtin_memset(codes, kCodeFree, 64);
  } else {
    std::int32_t at[64];
    Line row = line(places.row, places.row_step);
    Line column = line(places.column, places.column_step);
    const F8 last_row = all(grid.rows - 0.5F), last_column = all(grid.columns - 0.5F);
    const I8 stride = I8{} + grid.stride;
    if (places.within[cell]) {
      for (int i = 0; i < 8; ++i) {
        store(truncated(row(i)) * stride + truncated(column(i)), at + 8 * i);
      }
    } else {
      for (int i = 0; i < 8; ++i) {
        const I8 rows = truncated(smaller(larger(row(i), F8{}), last_row));
        const I8 columns = truncated(smaller(larger(column(i), F8{}), last_column));
        store(rows * stride + columns, at + 8 * i);
      }
    }
    take(grid.codes, at, codes);
    if (shares != nullptr) take(grid.shares, at, shares);
  }
  if ((classes & kCutByAperture) != 0) {
    Line spread = line(places.spread, places.spread_step);
    const float height_step[3] = {task.cos_half_aperture * task.voxel_step[0][2],
                                  task.cos_half_aperture * task.voxel_step[1][2],
                                  task.cos_half_aperture * task.voxel_step[2][2]};
    Line height(places.height[cell], height_step);
    alignas(16) std::uint8_t in[64], nearly[64];
    for (int i = 0; i < 8; ++i) {
      const F8 inside = spread(i) - absolute(height(i));
      store(bytes_of(inside > 0.0F), in + 8 * i);
      store(bytes_of(inside > -0.5F), nearly + 8 * i);
    }
    for (int i = 0; i < 64; i += 16) {
      const auto code = load<B16>(codes + i);
      const B16 occupied = reinterpret_cast<B16>(code >= kCodeOccupied);
      store(code & (load<B16>(in + i) | (occupied & load<B16>(nearly + i))), codes + i);
    }
  }
  return count_codes(codes);
}

inline bool all_alike(const std::uint8_t* counts) {
  const auto words = load<Vector<std::uint64_t, 2>>(counts);
  return words[0] == words[1] && words[0] == (words[0] & 0xFF) * 0x0101010101010101U;
}

inline bool all_alike(const std::uint16_t* counts) {
  const auto words = load<Vector<std::uint64_t, 4>>(counts);
  return words[0] == words[1] && words[2] == words[3] && words[0] == words[2] &&
         words[0] == (words[0] & 0xFFFF) * 0x0001000100010001U;
}

// Sixteen voxels' learning rate by their counts: a division is quicker than sixteen loads.
template <typename Count>
inline S16 alphas(const RuleTables& rule, const Count* counts) {
  if (all_alike(counts)) return all16(rule.alpha[counts[0]]);
  const auto rate = [&rule](F8 count) {
    const F8 exact = 1.0F / (1.0F + rule.decay_rate * count);
    return smaller(truncated(larger(exact, all(rule.min_alpha)) * 32768.0F + 0.5F), I8{} + 32767);
  };
  return joined(rate(eight_floats(counts)), rate(eight_floats(counts + 8)));
}

template <typename Count, bool kMean>
bool apply_to(const RuleTables& rule, const std::uint8_t* codes, const std::uint8_t* shares,
              std::int16_t* units, Count* counts) {
  using Counts = Vector<Count, 16>;
  S16 changed{};
  for (int i = 0; i < 64; i += 16, units += 16, counts += 16) {
    const auto bytes = load<B16>(codes + i);
    const S16 code = widened(bytes);
    const auto level = load<S16>(units);
    const S16 occupied = code >= kCodeOccupied;
    const S16 free = code == kCodeFree;
    const S16 alpha = alphas(rule, counts);
    S16 rate = alpha;
    const S16 low = occupied & (level < rule.occupied_unscaled_from);
    const S16 most = multiply_q15(alpha, all16(rule.max_ratio));
    rate = low ? all16(rule.min_ratio) : alpha;
    const S16 more = low & (most > rule.min_ratio);  // their scale matters
    if (any(more)) {
      std::int16_t rates[16];
      store(rate, rates);
      for_each_lane(more, [&](int k) {
        const std::int16_t scaled =
            multiply_q15(alpha[k], rule.occupied_scale[units[k] - rule.min_units]);
        rates[k] = scaled > rule.min_ratio ? scaled : rule.min_ratio;
      });
      rate = load<S16>(rates);
    }
    const S16 full =
        rule.code_base + multiply_q15((code - kCodeOccupied) << 7, all16(rule.code_slope));
    S16 up = multiply_q15(full, rate);
    S16 down = multiply_q15(all16(rule.full_free), alpha);
    const S16 high = (kMean ? occupied | free : free) & (level > rule.unscaled_up_to);
    if (any(high)) {
      std::int16_t steps[16];
      store(down, steps);
      for_each_lane(high, [&](int k) {
        steps[k] = multiply_q15(steps[k], rule.free_scale[units[k] - rule.min_units]);
      });
      down = load<S16>(steps);
    }
    S16 rises = occupied;
    if constexpr (kMean) {
      const S16 share = widened(load<B16>(shares + i));
      const S16 part = (share << 7) + (share >> 1);
      const S16 net = multiply_q15(up, part) - multiply_q15(down, 32767 - part);
      rises = occupied & (net >= 0);
      up = net;
      down = occupied ? -net : down;
    }
    const auto unsign = [](S16 a) { return reinterpret_cast<U16>(a); };
    // From clamp to clamp is more than 16 bits with a sign hold.
    const U16 from = unsign(level);
    const U16 room_up = unsign(all16(rule.max_units)) - from;
    const U16 room_down = from - unsign(all16(rule.min_units));
    const auto raised = reinterpret_cast<S16>(from + smaller(unsign(up), room_up));
    const auto lowered = reinterpret_cast<S16>(from - smaller(unsign(down), room_down));
    const S16 touched = occupied | free;
    const S16 updated = rises ? raised : (touched ? lowered : level);
    const auto n = load<Counts>(counts);
    const auto learns = reinterpret_cast<Counts>(n < static_cast<Count>(rule.settled_count)) &
                        __builtin_convertvector(touched, Counts);
    const Counts next = n - learns;
    changed |= (updated != level) | reinterpret_cast<S16>(__builtin_convertvector(learns, U16));
    store(updated, units);
    store(next, counts);
  }
  return any(changed);
}

bool apply(const RuleTables& rule, const std::uint8_t* codes, const std::uint8_t* shares,
           std::int16_t* units, std::byte* counts, int count_bytes) {
  if (count_bytes == 1) {
    auto* const narrow = reinterpret_cast<std::uint8_t*>(counts);
    return shares == nullptr ? apply_to<std::uint8_t, false>(rule, codes, shares, units, narrow)
                             : apply_to<std::uint8_t, true>(rule, codes, shares, units, narrow);
  }
  auto* const wide = reinterpret_cast<std::uint16_t*>(counts);
  return shares == nullptr ? apply_to<std::uint16_t, false>(rule, codes, shares, units, wide)
                           : apply_to<std::uint16_t, true>(rule, codes, shares, units, wide);
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels{MAPPERD_KERNELS_NAME, build_rows, place_cells, look_up, apply};

}  // namespace MAPPERD_KERNELS
}  // namespace mapperd::map
