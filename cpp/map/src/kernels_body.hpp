// The kernels' text, included once a target; MAPPERD_KERNELS names the target's namespace.
// Nothing but plain data and vectors of it: see kernels.hpp.
#include "mapperd/map/kernels.hpp"

namespace mapperd::map {
namespace MAPPERD_KERNELS {
namespace {

using Lanes = float __attribute__((vector_size(sizeof(float) * kLanes)));

inline Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }
inline Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }
inline Lanes all(float value) { return Lanes{} + value; }

inline Lanes load(const float* values) {
  Lanes lanes;
  __builtin_memcpy(&lanes, values, sizeof lanes);
  return lanes;
}

inline float sum(Lanes a) {
  return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]));
}

struct Sums {
  Lanes occupied{};
  Lanes weighted{};
  Lanes squared{};
  Lanes free{};
};

// Eight lines of a voxel.
class Lines {
 public:
  Lines(const LineTask& task, Lanes u, Lanes v)
      : task_(task),
        u_(u),
        v_(v),
        across_(u * u + v * v),
        ahead_(task.ahead_u * u + task.ahead_v * v) {
    Lanes low = all(-task.half);
    Lanes high = all(task.half);
    low_ = row_at(low);
    high_ = row_at(high);
    metres_per_row_ = 2 * task.half / (high_ - low_);
    if (task.cones == 0) return;
    for (int i = 0; i < task.cones; ++i) {
      keep(task.cone[i], crossing(task.cone[i], task.cone_base[i]), low, high);
    }
    low_ = row_at(low);
    high_ = row_at(high);
  }

  // Rows grow along the lines, so that pieces of them are pieces in rows.
  void add(Sums& sums) const {
    Lanes lower{};
    Lanes upper = row_at(crossing(task_.edge[0], task_.edge_base[0]));
    for (int j = 0; j < task_.beams; ++j) {
      lower = upper;
      upper = row_at(crossing(task_.edge[j + 1], task_.edge_base[j + 1]));
      const LineBeam& beam = task_.beam[j];
      if (beam.returns == 0 && !(beam.free_row > 0)) continue;
      Lanes from = low_;
      Lanes to = high_;
      if (j > 0 || task_.outermost_low) keep(task_.edge[j], lower, from, to);
      if (j + 1 < task_.beams || task_.outermost_high) {
        drop(task_.edge[j + 1], upper, from, to);
      }
      if (task_.min_row > 0) {
        from = larger(from, all(task_.min_row));
        to = larger(to, all(task_.min_row));
      }
      to = larger(from, to);
      if (beam.free_row > 0) add_free(beam, from, to, sums);
      if (beam.returns != 0) add_returns(beam, from, to, sums);
    }
  }

 private:
  // Range along the lines, to third order in the voxel's size over its range.
  Lanes row_at(Lanes t) const {
    const Lanes along = ahead_ + task_.ahead_t * t;
    const Lanes bend = (across_ + t * t - along * along) * (0.5F * task_.inverse_range);
    const Lanes range = along + bend * (1.0F - along * task_.inverse_range);
    return task_.row + range * task_.rows_per_m;
  }

  Lanes crossing(const LinePlane& plane, float base) const {
    const Lanes value = base + plane.u * u_ + plane.v * v_;
    return smaller(larger(value * plane.minus_inverse_t, all(-task_.half)), all(task_.half));
  }

  // Narrows a piece of the lines to a plane's inner side, or to its outer side.
  static void keep(const LinePlane& plane, Lanes crossing, Lanes& from, Lanes& to) {
    if (plane.t > 0) {
      from = larger(from, crossing);
    } else {
      to = smaller(to, crossing);
    }
  }
  static void drop(const LinePlane& plane, Lanes crossing, Lanes& from, Lanes& to) {
    if (plane.t > 0) {
      to = smaller(to, crossing);
    } else {
      from = larger(from, crossing);
    }
  }

  void add_free(const LineBeam& beam, Lanes near, Lanes far, Sums& sums) const {
    sums.free += larger(smaller(far, all(beam.free_row)) - near, Lanes{}) * metres_per_row_;
  }

  void add_returns(const LineBeam& beam, Lanes near, Lanes far, Sums& sums) const {
    // What of the piece lies beyond a row's edge, but for a constant: inside the row lies the
    // difference of two of them.
    const auto beyond = [near, far](int row) {
      const Lanes edge = all(static_cast<float>(row));
      return larger(far, edge) - larger(near, edge);
    };
    Lanes rows{};
    Lanes weight{};
    Lanes squared{};
    Lanes next{};
    int after = -1;  // the row whose edge `next` stands for
    for (std::uint64_t left = beam.returns; left != 0; left &= left - 1) {
      const int k = __builtin_ctzll(left);
      const Lanes here = k == after ? next : beyond(k);
      after = k + 1;
      next = beyond(after);
      const Lanes part = here - next;
      const float w = beam.weight[k];
      rows += part;
      weight += w * part;
      squared += w * w * part;
    }
    sums.occupied += rows * metres_per_row_;
    sums.weighted += weight * metres_per_row_;
    sums.squared += squared * metres_per_row_;
  }

  const LineTask& task_;
  Lanes u_;
  Lanes v_;
  Lanes across_;  // squared distance of the line from the centre
  Lanes ahead_;   // how much farther than the centre the line's middle is
  Lanes metres_per_row_;
  Lanes low_;  // rows between which each line lies inside the aperture
  Lanes high_;
};

LineSums lines(const LineTask& task, const float* u, const float* v, int chunks) {
  Sums sums;
  const float edge = 2 * task.half;
  for (int i = 0; i < chunks; ++i) {
    Lines(task, load(u + i * kLanes) * edge, load(v + i * kLanes) * edge).add(sums);
  }
  const float scale = 1.0F / static_cast<float>(kLanes * chunks);
  return {sum(sums.occupied) * scale, sum(sums.weighted) * scale, sum(sums.squared) * scale,
          sum(sums.free) * scale};
}

using Row = double __attribute__((vector_size(sizeof(double) * kCellEdge)));

inline Row root(Row a) {
  for (int i = 0; i < kCellEdge; ++i) a[i] = __builtin_sqrt(a[i]);
  return a;
}

inline Row row_of(const CellLine& line, int y, int z) {
  constexpr Row kX{0, 1, 2, 3};
  return line.first + y * line.step[1] + z * line.step[2] + kX * line.step[0];
}

inline void store(Row a, double* values) { __builtin_memcpy(values, &a, sizeof a); }

void places(const CellTask& task, CellPlaces& places) {
  for (int row = 0; row < kCellEdge * kCellEdge; ++row) {
    const int y = row % kCellEdge;
    const int z = row / kCellEdge;
    const Row ahead = row_of(task.ahead, y, z);
    const Row port = row_of(task.port, y, z);
    const Row up = row_of(task.up, y, z);
    const Row flat = ahead * ahead + port * port;
    // Never 0, by which is divided.
    const Row horizontal = root(flat) + 1e-300;
    const Row height = up < 0.0 ? -up : up;
    const Row low = row_of(task.low_side, y, z);
    const Row high = row_of(task.high_side, y, z);
    store(root(flat + up * up), &places.range[row * kCellEdge]);
    store(horizontal, &places.horizontal[row * kCellEdge]);
    store(-port / horizontal, &places.sine[row * kCellEdge]);
    store(horizontal * task.sin_half_aperture - height * task.cos_half_aperture,
          &places.inside_aperture[row * kCellEdge]);
    store(low < high ? low : high, &places.inside_sides[row * kCellEdge]);
  }
}

Lowered lower(std::int32_t* units, std::uint16_t* count, const std::uint16_t* rows,
              const std::uint32_t* down, const std::uint32_t* next, std::int32_t min_units,
              std::int32_t limit) {
  constexpr int kEdge = 16;
  std::uint32_t above = 0;
  std::uint32_t moved = 0;
  for (int row = 0; row < kEdge * kEdge; ++row, units += kEdge, count += kEdge) {
    if (rows[row] == 0) continue;
    for (int i = 0; i < kEdge; ++i) {
      const bool taken = (rows[row] >> i & 1) != 0;
      const bool lowered = taken && units[i] <= limit;
      above |= taken && !lowered ? 1U : 0U;
      const std::uint32_t step = down[count[i]];
      // Modulo 2^32, so that no sum overflows.
      const auto room =
          static_cast<std::uint32_t>(units[i]) - static_cast<std::uint32_t>(min_units);
      const std::int32_t after =
          room <= step ? min_units
                       : static_cast<std::int32_t>(static_cast<std::uint32_t>(units[i]) - step);
      const auto after_count = static_cast<std::uint16_t>(next[count[i]]);
      moved |= lowered && (after != units[i] || after_count != count[i]) ? 1U : 0U;
      units[i] = lowered ? after : units[i];
      count[i] = lowered ? after_count : count[i];
    }
  }
  return {above != 0, moved != 0};
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels{MAPPERD_KERNELS_NAME, lines, places, lower};

}  // namespace MAPPERD_KERNELS
}  // namespace mapperd::map
