#include "mapperd/acoustics/preview.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <vector>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/common/fast_math.hpp"

namespace mapperd::acoustics {

namespace {

/// The normal's gradient G has the principal curvatures as its eigenvalues.
void curvatures(const double* curved_normal, const Vec3& tangent, double* turn) {
  double squares = 0.0;
  double trace = 0.0;
  Vec3 along;
  for (std::size_t i = 0; i < 3; ++i) {
    const double* g = curved_normal + 4 * i;
    squares += g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
    trace += g[i];
    along = along + tangent[i] * Vec3{g[0], g[1], g[2]};
  }
  const double product = (trace * trace - squares) / 2.0;
  turn[0] = squares;
  turn[1] = product * product;
  turn[2] = dot(along, along);
}

constexpr double kGrazing = 1e-3;  // cosine of incidence below which a patch has no size; the
                                   // rules have the same

constexpr std::size_t kAhead = 16;  // rays; half as many for what their faces refer to

/// Rays hit faces all over a large table: without this most of the time is waiting for memory.
void prefetch_face(const Faces& faces, const CoarseRays& rays, std::size_t i) {
  if (i + kAhead < rays.count && rays.face[i + kAhead] >= 0) {
    __builtin_prefetch(&faces.table[rays.face[i + kAhead]]);
  }
  if (i + kAhead / 2 < rays.count && rays.face[i + kAhead / 2] >= 0) {
    const Face& face = faces.table[rays.face[i + kAhead / 2]];
    if (face.smooth < 0) return;
    const double* curved = faces.curved_normal + 12 * static_cast<std::ptrdiff_t>(face.smooth);
    __builtin_prefetch(curved);
    __builtin_prefetch(curved + 8);
  }
}

void store(const Vec3& v, double* to) {
  for (std::size_t axis = 0; axis < 3; ++axis) to[axis] = v[axis];
}

}  // namespace

std::size_t coarse_patches(const Faces& faces, const CoarseRays& rays, double reach_m,
                           const Transform* map_T_group, const CoarsePatches& to) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < rays.count; ++i) {
    prefetch_face(faces, rays, i);
    const auto range_m = static_cast<double>(rays.range_m[i]);
    if (rays.face[i] < 0 || !(range_m < reach_m)) continue;
    const Face& face = faces.table[rays.face[i]];
    const Transform& map_T_object = map_T_group[rays.group[i]];
    const double* d = rays.direction + 3 * i;
    const Vec3 direction{d[0], d[1], d[2]};
    const Vec3 map_direction = rays.map_T_sonar.rotate(direction);
    const Vec3 point_m = rays.map_T_sonar.translation + range_m * map_direction;
    Vec3 n{face.plane[0], face.plane[1], face.plane[2]};
    double turn[3] = {0.0, 0.0, 0.0};
    if (face.smooth >= 0) {
      const double* curved = faces.curved_normal + 12 * static_cast<std::ptrdiff_t>(face.smooth);
      n = curved_normal_at(curved, map_T_object.rotate_back(point_m - map_T_object.translation));
      const Vec3 way = map_T_object.rotate_back(map_direction);
      curvatures(curved, way - dot(way, n) * n, turn);
    }
    n = map_T_object.rotate(n);
    // Over the patch's plane dR = -R (n.dd) / (n.d), and x dx = -(y dy + z dz).
    const Vec3 seen = rays.map_T_sonar.rotate_back(n);
    const double cosine = std::fabs(dot(seen, direction));
    const double facing = std::max(cosine, kGrazing);
    const double across = std::fabs(seen.x * d[1] / d[0] - seen.y) * rays.s_step;
    const double along = std::fabs(seen.z - seen.x * d[2] / d[0]) * rays.w_step;
    const double variance_m2 = range_m * rays.w_step * (range_m * rays.w_step) / 12.0;
    to.ray[count] = static_cast<std::int64_t>(i);
    store(point_m, to.point_m + 3 * count);
    store(n, to.normal + 3 * count);
    to.cos_incidence[count] = cosine;
    to.area_m2[count] = range_m * range_m * rays.solid_angle_sr[i] / facing;
    to.extent_m[count] = std::min(range_m / facing * (across + along), range_m);
    store({turn[0] * variance_m2, turn[1] * variance_m2 * variance_m2, turn[2] * variance_m2},
          to.turn + 3 * count);
    ++count;
  }
  return count;
}

void spread_over_rows(const RangePatches& patches, double row_m, std::size_t rows,
                      std::size_t columns, double* picture) {
  // Where patches begin less where they end, then summed along the rows.
  std::vector<double> steps((rows + 1) * columns, 0.0);
  // NaN counts as the first row.
  const auto row_of = [rows](double row) {
    return row > 0.0 ? static_cast<std::size_t>(std::min(row, static_cast<double>(rows))) : 0;
  };
  for (std::size_t i = 0; i < patches.count; ++i) {
    if (patches.power[i] == 0.0) continue;
    const double reach_m = std::max(patches.extent_m[i], row_m);
    const double density = patches.power[i] / reach_m;
    const double first = std::floor((patches.range_m[i] - reach_m / 2.0) / row_m + 0.5);
    const double last = first + std::max(std::nearbyint(reach_m / row_m), 1.0);
    const auto column = static_cast<std::size_t>(patches.column[i]);
    steps[row_of(first) * columns + column] += density;
    steps[row_of(last) * columns + column] -= density;
  }
  std::vector<double> sum(columns, 0.0);
  for (std::size_t row = 0; row < rows; ++row) {
    for (std::size_t column = 0; column < columns; ++column) {
      sum[column] += steps[row * columns + column];
      picture[row * columns + column] = std::max(sum[column], 0.0);
    }
  }
}

namespace {

MAPPERD_VECTORISED void limit_each(const double* from, std::size_t count, double limit,
                                   double factor, float* to) {
  for (std::size_t i = 0; i < count; ++i) {
    const double positive = from[i] > 0.0 ? from[i] : 0.0;
    to[i] = static_cast<float>((positive < limit ? positive : limit) * factor);
  }
}

using Picture = std::vector<float>;

MAPPERD_INLINE float smaller(float a, float b) { return a < b ? a : b; }
MAPPERD_INLINE float larger(float a, float b) { return a > b ? a : b; }

/// Moves each pixel's bounds towards the lowest and highest of itself and two neighbours.
MAPPERD_VECTORISED void widen_row(const float* low, const float* before, const float* after,
                                  const float* high, const float* high_before,
                                  const float* high_after, std::size_t count, float part,
                                  float* to_low, float* to_high) {
  for (std::size_t i = 0; i < count; ++i) {
    const float lowest = smaller(smaller(before[i], after[i]), low[i]);
    const float highest = larger(larger(high_before[i], high_after[i]), high[i]);
    to_low[i] = low[i] + part * (lowest - low[i]);
    to_high[i] = high[i] + part * (highest - high[i]);
  }
}

MAPPERD_VECTORISED void square(const float* from, std::size_t count, float* to) {
  for (std::size_t i = 0; i < count; ++i) to[i] = from[i] * from[i];
}

// Of bounds on the squares.
MAPPERD_VECTORISED void clip(const float* value, const float* low, const float* high,
                             std::size_t count, float* to) {
  for (std::size_t i = 0; i < count; ++i) {
    to[i] = std::sqrt(smaller(larger(value[i] * value[i], low[i]), high[i]));
  }
}

void widen_along_rows(const Picture& low, const Picture& high, std::size_t rows,
                      std::size_t columns, float part, Picture& to_low, Picture& to_high) {
  for (std::size_t row = 0; row < rows; ++row) {
    const std::size_t here = row * columns;
    const std::size_t above = row == 0 ? here : here - columns;
    const std::size_t below = row + 1 == rows ? here : here + columns;
    widen_row(&low[here], &low[above], &low[below], &high[here], &high[above], &high[below],
              columns, part, &to_low[here], &to_high[here]);
  }
}

void widen_along_columns(const Picture& low, const Picture& high, std::size_t rows,
                         std::size_t columns, float part, Picture& to_low, Picture& to_high) {
  for (std::size_t row = 0; row < rows; ++row) {
    const float* l = &low[row * columns];
    const float* h = &high[row * columns];
    float* to_l = &to_low[row * columns];
    float* to_h = &to_high[row * columns];
    const std::size_t end = columns - 1;
    if (columns == 1) {
      *to_l = *l;
      *to_h = *h;
      continue;
    }
    widen_row(l, l, l + 1, h, h, h + 1, 1, part, to_l, to_h);
    widen_row(l + 1, l, l + 2, h + 1, h, h + 2, columns - 2, part, to_l + 1, to_h + 1);
    widen_row(l + end, l + end - 1, l + end, h + end, h + end - 1, h + end, 1, part, to_l + end,
              to_h + end);
  }
}

/// The nearest amplitude to each pixel of a picture that a displacement brings there from the
/// other.
Picture nearest(const float* picture, const float* other, const PicturePair& pair) {
  const std::size_t size = pair.rows * pair.columns;
  if (size == 0) return {};
  Picture low(size);
  square(other, size, low.data());
  Picture high = low;
  Picture next_low(size);
  Picture next_high(size);
  for (const bool along_rows : {true, false}) {
    const double farthest = static_cast<double>(along_rows ? pair.rows : pair.columns);
    const double cells = std::min(along_rows ? pair.row_cells : pair.column_cells, farthest);
    const int steps = static_cast<int>(std::ceil(cells));
    for (int step = 0; step < steps; ++step) {
      const auto part = static_cast<float>(cells / steps);
      const auto widen = along_rows ? widen_along_rows : widen_along_columns;
      widen(low, high, pair.rows, pair.columns, part, next_low, next_high);
      low.swap(next_low);
      high.swap(next_high);
    }
  }
  clip(picture, low.data(), high.data(), size, next_low.data());
  return next_low;
}

struct Quantiser {
  float gamma;
  float largest_pixel;
  float least;  ///< amplitude of half a step: what the integer 0 stands for at most
};

/// Ratio of amplitudes, at least 1; 1 where less than a step of the quantiser lies between them.
MAPPERD_VECTORISED void ratios(const float* a, const float* b, std::size_t count,
                               const Quantiser& quantiser, float* ratio) {
  const float least = quantiser.least;
  for (std::size_t i = 0; i < count; ++i) {
    const float low = larger(smaller(a[i], b[i]), least);
    const float high = larger(larger(a[i], b[i]), least);
    ratio[i] = smaller(high / low, std::numeric_limits<float>::max());
  }
  if (quantiser.gamma == 1.0F) {
    for (std::size_t i = 0; i < count; ++i) {
      const float steps = std::fabs(a[i] - b[i]) * quantiser.largest_pixel;
      ratio[i] = steps > 1.0F ? ratio[i] : 1.0F;
    }
    return;
  }
  for (std::size_t i = 0; i < count; ++i) {
    const float pixel = fast_power(a[i], quantiser.gamma);
    const float steps = std::fabs(pixel - fast_power(b[i], quantiser.gamma));
    ratio[i] = steps * quantiser.largest_pixel > 1.0F ? ratio[i] : 1.0F;
  }
}

MAPPERD_VECTORISED void keep_smaller(const float* other, std::size_t count, float* ratio) {
  for (std::size_t i = 0; i < count; ++i) ratio[i] = smaller(ratio[i], other[i]);
}

/// The largest ratio but for some, 1 if no more than these differ.
float largest_but(const Picture& ratio, std::size_t exceeding) {
  std::vector<float> changed;
  std::copy_if(ratio.begin(), ratio.end(), std::back_inserter(changed),
               [](float value) { return value > 1.0F; });
  if (changed.size() <= exceeding) return 1.0F;
  const auto at = changed.begin() + static_cast<std::ptrdiff_t>(exceeding);
  std::nth_element(changed.begin(), at, changed.end(), std::greater<>());
  return *at;
}

}  // namespace

void limited(const double* from, std::size_t count, double limit, double factor, float* to) {
  limit_each(from, count, limit, factor, to);
}

double pixel_change_db(const PicturePair& pictures, float largest_pixel, std::size_t exceeding) {
  const std::size_t size = pictures.rows * pictures.columns;
  const double least =
      std::pow(0.5 / static_cast<double>(largest_pixel), 1.0 / static_cast<double>(pictures.gamma));
  const Quantiser quantiser{pictures.gamma, largest_pixel,
                            static_cast<float>(std::max(least, 1e-37))};
  Picture ratio(size);
  ratios(pictures.first, pictures.second, size, quantiser, ratio.data());
  float change = largest_but(ratio, exceeding);
  if (change > 1.0F && (pictures.row_cells > 0.0 || pictures.column_cells > 0.0)) {
    // Displacing blurs edges, so either picture may be the one that is displaced.
    Picture back(size);
    ratios(pictures.first, nearest(pictures.first, pictures.second, pictures).data(), size,
           quantiser, ratio.data());
    ratios(pictures.second, nearest(pictures.second, pictures.first, pictures).data(), size,
           quantiser, back.data());
    keep_smaller(back.data(), size, ratio.data());
    change = largest_but(ratio, exceeding);
  }
  return 20.0 * std::log10(static_cast<double>(change));
}

namespace {

constexpr std::size_t kBands = 8;     // of range, in which dark pixels are averaged
constexpr double kDarkPart = 0.25;    // of a band, at least, for its mean to count
constexpr double kBlackPixel = 0.02;  // steps of the quantiser: a mean pixel below counts as black

double change_of_dark_db(const float* first, const float* second, const PicturePair& shape,
                         const DarkPixels& dark) {
  const std::size_t band = shape.rows / kBands * shape.columns;
  const float per_amplitude = static_cast<float>(dark.entries) / dark.limit;
  // Of a gamma next to 0 no amplitude is dark.
  if (!std::isfinite(per_amplitude)) return 0.0;
  double change_db = 0.0;
  for (std::size_t k = 0; k < kBands; ++k) {
    std::size_t count = 0;
    std::array<double, 2> sum{};
    for (std::size_t i = k * band; i < (k + 1) * band; ++i) {
      if (!(first[i] >= 0.0F && first[i] < dark.limit)) continue;
      if (!(second[i] >= 0.0F && second[i] < dark.limit)) continue;
      ++count;
      sum[0] +=
          static_cast<double>(dark.mean_pixel[static_cast<std::size_t>(first[i] * per_amplitude)]);
      sum[1] +=
          static_cast<double>(dark.mean_pixel[static_cast<std::size_t>(second[i] * per_amplitude)]);
    }
    if (static_cast<double>(count) <= kDarkPart * static_cast<double>(band)) continue;
    const auto all = static_cast<double>(count);
    const double ratio = std::max(sum[0] / all, kBlackPixel) / std::max(sum[1] / all, kBlackPixel);
    const double of_band_db =
        std::fabs(20.0 / static_cast<double>(shape.gamma) * std::log10(ratio));
    change_db = std::max(change_db, of_band_db);
  }
  return change_db;
}

}  // namespace

double dark_change_db(const PicturePair& pictures, const DarkPixels& dark) {
  const float* first = pictures.first;
  const float* second = pictures.second;
  if (!(pictures.row_cells > 0.0 || pictures.column_cells > 0.0)) {
    return change_of_dark_db(first, second, pictures, dark);
  }
  // Either picture may be the one that is displaced.
  const Picture there = nearest(first, second, pictures);
  const Picture back = nearest(second, first, pictures);
  return std::min(change_of_dark_db(first, there.data(), pictures, dark),
                  change_of_dark_db(back.data(), second, pictures, dark));
}

}  // namespace mapperd::acoustics
