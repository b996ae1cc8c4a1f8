#include <algorithm>
#include <cmath>

#include "mapperd/acoustics/bands.hpp"
#include "mapperd/acoustics/echo_response.hpp"
#include "mapperd/acoustics/scatter.hpp"

namespace mapperd::acoustics {

namespace {

constexpr double kMaxPieces = 512.0;
constexpr double kRowsPerPiece = 1.0;
constexpr double kMinAhead = 1e-6;
// Widths in s that are less than this part of x² are angles of width / x, to 0.03 %.
constexpr double kMaxFlatCell = 0.05;

// Mean powers of one hit after another, into a band of the picture.
class MeanPowerKernel {
 public:
  MeanPowerKernel(const ScatterInput& echoes, const Band& band, float* power)
      : e_(echoes), band_(band), power_(power) {}

  // Takes the hits of a batch; returns the next one.
  std::size_t add(std::size_t first, std::size_t last) {
    const std::size_t next = footprints_of(e_, first, last, footprints_);
    for (std::size_t i = 0; i < footprints_.count; ++i) {
      if (footprints_.exists[i]) {
        begin(i);
        cut(footprints_.hit[i]);
      }
    }
    return next;
  }

 private:
  struct Extent {
    double across_m, along_m;
  };

  // Cuts a hit's cell into pieces so small that each lies within about one row.
  void cut(std::size_t hit) {
    const float* cell = e_.hits.cell + 4 * hit;
    const double s_width = cell[1] - cell[0];
    const double w_width = cell[3] - cell[2];
    const double s_mid = 0.5 * (cell[0] + cell[1]);
    const double w_mid = 0.5 * (cell[2] + cell[3]);
    const Extent all = extent_of(s_mid, w_mid, s_width, w_width);
    const double max_m = far_m_ - near_m_;
    const double s_count = pieces(std::min(all.across_m, max_m));
    const double w_count = pieces(std::min(all.along_m, max_m));
    for (double i = 0.5; i < s_count; i += 1.0) {
      for (double j = 0.5; j < w_count; j += 1.0) {
        const double s = cell[0] + s_width * i / s_count, w = cell[2] + w_width * j / w_count;
        piece(s + s_per_w_ * (w - w_mid), w + w_per_s_ * (s - s_mid), s_width / s_count,
              w_width / w_count);
      }
    }
  }

  [[nodiscard]] double pieces(double extent_m) const {
    const double rows = std::ceil(extent_m * e_.grid.range_scale / (kRowsPerPiece * e_.grid.row_m));
    return std::clamp(rows, curved_normal_ != nullptr || strength_.has_lobe() ? 8.0 : 4.0,
                      kMaxPieces);
  }

  void begin(std::size_t patch) {
    const RayHits& hits = e_.hits;
    const std::size_t hit = footprints_.hit[patch];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      plane_normal_[axis] = footprints_.normal[axis][patch];
    }
    height_m_ = footprints_.height_m[patch];
    min_facing_ = footprints_.min_facing[patch];
    min_m_ = footprints_.min_m[patch];
    max_m_ = footprints_.max_m[patch];
    near_m_ = footprints_.near_m[patch];
    far_m_ = footprints_.far_m[patch];
    const Face& face = e_.faces.table[hits.face[hit]];
    seen_ = &hits.legs[hits.seen[hit]];
    transmit_ = &hits.legs[hits.transmit[hit]];
    receive_ = &hits.legs[hits.receive[hit]];
    const float* cell = hits.cell + 4 * hit;
    s_per_w_ = hits.lean == nullptr ? 0.0F : hits.lean[2 * hit];
    w_per_s_ = hits.lean == nullptr ? 0.0F : hits.lean[2 * hit + 1];
    const double step_rad = 0.125 * std::max(cell[1] - cell[0], cell[3] - cell[2]);
    curved_normal_ = face.smooth < 0 ? nullptr : e_.faces.curved_normal + 12 * face.smooth;
    const double turn = 1.0 + face.turn_per_m * far_m_;
    strength_ = Strength(e_.model, e_.faces.materials[face.material], step_rad * turn);
    gain_ = hits.gain[hit] * transmit_->gain * receive_->gain;
    const auto& m = seen_->rotation;
    const Vec3& n = plane_normal_;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      normal_[axis] = m[axis] * n[0] + m[3 + axis] * n[1] + m[6 + axis] * n[2];
    }
  }

  // How far a cell reaches in range: on the plane R = height / n.d, so dR = -R (n.dd) / (n.d).
  [[nodiscard]] Extent extent_of(double s, double w, double s_width, double w_width) const {
    const double x = std::sqrt(std::max(1.0 - s * s - w * w, 1e-6));
    const double facing =
        std::max(std::fabs(normal_[0] * x - normal_[1] * s + normal_[2] * w), min_facing_);
    const double reach_m = std::fabs(height_m_) / (facing * facing);
    const double by_s = -normal_[0] * s / x - normal_[1];
    const double by_w = normal_[2] - normal_[0] * w / x;
    return {reach_m * std::fabs(by_s + w_per_s_ * by_w) * s_width,
            reach_m * std::fabs(by_w + s_per_w_ * by_s) * w_width};
  }

  struct Bearing {
    double s, ahead;   // of the piece's middle
    double angle_rad;  // that its width in s is about the axis of w
  };

  // A width ds is ds / x of an angle, which grows beyond all bounds where the directions end.
  static Bearing bearing_of(double s, double w, double s_width) {
    const double square = 1.0 - s * s - w * w;
    if (s_width < kMaxFlatCell * square) {
      const double ahead = std::sqrt(square);
      return {s, ahead, s_width / ahead};
    }
    const ValidSines reals = valid_sines(s - 0.5 * s_width, s + 0.5 * s_width, w);
    const double from_rad = std::asin(reals.from_s / reals.max_s);
    const double to_rad = std::asin(reals.to_s / reals.max_s);
    const double middle_rad = 0.5 * (from_rad + to_rad);
    return {reals.max_s * std::sin(middle_rad),
            std::fmax(reals.max_s * std::cos(middle_rad), kMinAhead), to_rad - from_rad};
  }

  void piece(double middle_s, double w, double s_width, double w_width) {
    const Bearing bearing = bearing_of(middle_s, w, s_width);
    if (!(bearing.angle_rad > 0.0)) {
      return;
    }
    const double s = bearing.s;
    const Vec3 d = direction(*seen_, s, w);
    const double facing = dot(plane_normal_, d);
    if (facing * height_m_ <= 0.0 || std::fabs(facing) < min_facing_) {
      return;
    }
    const double range_m = std::clamp(height_m_ / facing, min_m_, max_m_);
    Vec3 point_m;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      point_m[axis] = seen_->origin_m[axis] + range_m * d[axis];
    }
    const Vec3 normal =
        curved_normal_ != nullptr ? curved_normal_at(curved_normal_, point_m) : plane_normal_;
    const double cosine =
        std::max(std::fabs(dot(normal, d)), curved_normal_ != nullptr ? kMinCosine : 0.0);
    const double area_m2 = range_m * range_m * bearing.angle_rad * w_width / cosine;
    const PolarPoint seen{range_m, s, w, d};
    const PolarPoint out = transmit_ == seen_ ? seen : polar_point(*transmit_, point_m);
    const PolarPoint back = receive_ == seen_ ? seen : polar_point(*receive_, point_m);
    const Extent extent = extent_of(s, w, bearing.angle_rad * bearing.ahead, w_width);
    const double section_m2 = area_m2 * cross_section(out, back, normal);
    const double extent_m = std::min(extent.across_m + extent.along_m, far_m_ - near_m_);
    heard(out, back, section_m2, extent_m);
    if (e_.hits.both_ways) {
      heard(back, out, section_m2, extent_m);
    }
  }

  [[nodiscard]] double cross_section(const PolarPoint& out, const PolarPoint& back,
                                     const Vec3& n) const {
    return strength_.at(std::fabs(dot(n, out.direction)), std::fabs(dot(n, back.direction)),
                        half_cosine(n, out.direction, back.direction));
  }

  void heard(const PolarPoint& out, const PolarPoint& back, double section_m2, double extent_m) {
    const EchoGrid& grid = e_.grid;
    const double way_m = 0.5 * (out.range_m + back.range_m);
    const double apparent_m = grid.range_scale * way_m + dot(receive_->drift_m, out.direction);
    const Spread at = spread_at(e_.response, column_of(grid, back.s));
    const std::ptrdiff_t column = at.column - band_.column;
    const auto taps = static_cast<std::ptrdiff_t>(e_.response.tap_count);
    if (column < 0 || column + taps > band_.columns) {
      return;
    }
    const double beam = static_cast<double>(vertical_at(e_.response, out.w)) *
                        static_cast<double>(vertical_at(e_.response, back.w)) * gain_;
    double power = section_m2 * beam * beam;
    if (e_.model.spreading) {
      power /= out.range_m * out.range_m * back.range_m * back.range_m;
    }
    const double height = std::max(extent_m * grid.range_scale / grid.row_m, 1e-6);
    over_rows(power, apparent_m / grid.row_m, height, column,
              e_.response.taps + at.fraction * e_.response.tap_count);
  }

  void over_rows(double power, double middle, double width, std::ptrdiff_t column,
                 const float* taps) {
    const double low = middle - 0.5 * width;
    const double high = middle + 0.5 * width;
    const double last = static_cast<double>(e_.grid.rows - 1);
    for (double row = std::max(std::floor(low), 0.0); row <= std::min(std::floor(high), last);
         row += 1.0) {
      const double part = (std::min(high, row + 1.0) - std::max(low, row)) / width;
      const auto at = static_cast<std::ptrdiff_t>(row);
      const double loss = e_.response.loss[at];
      const auto share = static_cast<float>(power * part * loss * loss);
      float* cell = power_ + at * e_.grid.columns + band_.column + column;
      for (std::size_t k = 0; k < e_.response.tap_count; ++k) {
        cell[k] += taps[k] * share;
      }
    }
  }

  const ScatterInput& e_;
  const Band& band_;
  float* power_;
  Footprints footprints_{};
  Vec3 plane_normal_{};  // object's frame
  double height_m_ = 0.0, min_facing_ = 0.0;
  double min_m_ = 0.0, max_m_ = 0.0, near_m_ = 0.0, far_m_ = 0.0;
  double s_per_w_ = 0.0, w_per_s_ = 0.0;  // see `RayHits::lean`
  Strength strength_{ScatterModel{}, Material{}, 0.0};
  const Leg* seen_ = nullptr;
  const Leg* transmit_ = nullptr;
  const Leg* receive_ = nullptr;
  const double* curved_normal_ = nullptr;
  Vec3 normal_{};  // sonar's frame
  double gain_ = 0.0;
};

}  // namespace

void scatter_power(const ScatterInput& echoes, float* power, int threads) {
  in_bands(bands_of(echoes, threads), threads, [&](const Band& band) {
    MeanPowerKernel averager(echoes, band, power);
    for (std::size_t hit = band.first; hit < band.last;) {
      hit = averager.add(hit, band.last);
    }
  });
}

}  // namespace mapperd::acoustics
