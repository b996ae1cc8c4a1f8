#include "mapperd/map/fan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string>

#include "mapperd/map/cube_cut.hpp"

namespace mapperd::map {
namespace {

constexpr double kHalfPi = 1.5707963267948966;
constexpr double kMaxCells = 64.0 * 1024 * 1024;  // far above 16 MiB of any real message
constexpr double kMaxRange = 10000.0;
constexpr double kFinestRow = 1e-6;
constexpr std::size_t kMaxBeams = 65536;
constexpr int kMostThreads = 64;

void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(what);
}

constexpr double kHalf = 0.5;
constexpr double kRounding = 1e-9;

}  // namespace

void check_ping(const PingImage& image, const FanSettings& settings) {
  require(image.rows >= 1 && image.beams >= 2,
          "intensity must have at least one row and two beams");
  require(static_cast<double>(image.rows) * static_cast<double>(image.beams) <= kMaxCells,
          "intensity has more than 2^26 samples");
  require(image.beams <= kMaxBeams, "intensity has more than 65536 beams");
  require(std::isfinite(image.range_resolution_m) && image.range_resolution_m >= kFinestRow,
          "range_resolution_m must be finite, and a micrometre or more");
  require(image.max_range_m() <= kMaxRange, "the ping reaches farther than 10 km");
  for (std::size_t j = 0; j < image.beams; ++j) {
    require(std::abs(image.bearings_rad[j]) <= kHalfPi,
            "bearings_rad must be finite and lie within +-90 degrees");
    require(j == 0 || image.bearings_rad[j] > image.bearings_rad[j - 1],
            "bearings_rad must increase strictly");
  }
  require(settings.vertical_aperture_rad > 0 && settings.vertical_aperture_rad < 2 * kHalfPi,
          "vertical_aperture_rad must lie between 0 and 180 degrees");
  require(std::isfinite(settings.min_range_m) && settings.min_range_m >= 0,
          "min_range_m must be finite, 0 or more");
  require(std::isfinite(settings.error_bound) && settings.error_bound >= 0,
          "error_bound must be finite, 0 or more");
  require(settings.threads >= 1 && settings.threads <= kMostThreads,
          "threads must lie between 1 and 64");
}

std::vector<double> beam_edges(const double* bearings_rad, std::size_t beams) {
  std::vector<double> sines(beams);
  std::transform(bearings_rad, bearings_rad + beams, sines.begin(),
                 [](double b) { return std::sin(b); });
  std::vector<double> edges(beams + 1);
  for (std::size_t j = 1; j < beams; ++j) edges[j] = 0.5 * (sines[j - 1] + sines[j]);
  edges[0] = sines[0] - 0.5 * (sines[1] - sines[0]);
  edges[beams] = sines[beams - 1] + 0.5 * (sines[beams - 1] - sines[beams - 2]);
  for (double& edge : edges) edge = std::asin(std::clamp(edge, -1.0, 1.0));
  return edges;
}

Fan::Fan(const PingImage& image, const FanSettings& settings, const IwloRule& rule,
         const Transform& map_T_sonar, const PingMotion& motion)
    : row_count_(image.rows),
      resolution_(image.range_resolution_m),
      rows_per_m_(1.0 / image.range_resolution_m),
      min_range_(settings.min_range_m),
      max_range_(image.max_range_m()),
      sin_half_(std::sin(settings.vertical_aperture_rad / 2)),
      cos_half_(std::cos(settings.vertical_aperture_rad / 2)),
      rotation_{map_T_sonar.rows, {}},
      edges_(beam_edges(image.bearings_rad, image.beams)),
      weights_(image.beams * image.rows, kNoReturn),
      return_rows_(image.beams, image.rows),
      free_limit_m_(image.beams, settings.carve_no_return ? image.max_range_m() : 0.0) {
  if (motion.any()) view_.emplace(motion, rotation_);
  for (const double edge : edges_) edge_normals_.push_back(normal_at(edge));
  index_sines();
  fill_weights(image, rule);
  least_free_m_ = RunExtreme<Smaller>(free_limit_m_);
  most_free_m_ = RunExtreme<Larger>(free_limit_m_);
  fill_profiles();
}

// Row by row, as the image lies in memory.
void Fan::fill_weights(const PingImage& image, const IwloRule& rule) {
  std::vector<bool> has_return(image.beams, false);
  // A row partly nearer than min_range counts with the part beyond.
  const double first = std::floor(min_range_ / resolution_ * (1 - 1e-12));
  for (auto k = static_cast<std::size_t>(std::min(first, 1e9)); k < row_count_; ++k) {
    if (!(static_cast<double>(k + 1) * resolution_ > min_range_)) continue;
    for (std::size_t j = 0; j < image.beams; ++j) {
      const float intensity = image.at(k, j);
      if (!rule.is_return(intensity)) continue;
      weights_[j * row_count_ + k] = static_cast<float>(rule.occupied_weight(intensity));
      return_rows_.mark(j, k);
      if (has_return[j]) continue;
      has_return[j] = true;
      free_limit_m_[j] = std::max(static_cast<double>(k) * resolution_, min_range_);
    }
  }
  return_rows_.build();
}

void Fan::fill_profiles() {
  std::vector<std::size_t> ends;
  for (std::size_t j = 0; j < beams(); ++j) {
    add_returns(j);
    ends.push_back(pieces_.size());
  }
  for (std::size_t j = 0; j < beams(); ++j) {
    if (free_limit_m_[j] > min_range_) {
      RadialBuilder free(pieces_);
      free.add(min_range_, {1.0, 1.0});
      free.add(free_limit_m_[j], {});
    }
    ends.push_back(pieces_.size());
  }
  link_profiles(ends);
}

void Fan::add_returns(std::size_t j) {
  RadialBuilder builder(pieces_);
  const float* weight = weights(j);
  bool inside = false;
  for (std::size_t k = return_rows_.next(j, 0); k < row_count_; k = return_rows_.next(j, k)) {
    builder.add(std::max(static_cast<double>(k) * resolution_, min_range_), {1.0, weight[k]});
    ++k;
    inside = k < row_count_ && weight[k] >= 0;
    if (!inside) builder.add(static_cast<double>(k) * resolution_, {});
  }
}

void Fan::link_profiles(const std::vector<std::size_t>& ends) {
  std::size_t begin = 0;
  for (std::size_t i = 0; i < 2 * beams(); ++i) {
    auto& profiles = i < beams() ? returns_ : free_space_;
    const double spacing = i < beams() ? resolution_ : 0.0;
    profiles.emplace_back(pieces_.data() + begin, ends[i] - begin, spacing);
    begin = ends[i];
  }
}

// Four cells a beam: the guess is then right or off by one.
void Fan::index_sines() {
  for (const double edge : edges_) edge_sines_.push_back(std::sin(edge));
  const std::size_t cells = 4 * beams();
  const double low = edge_sines_.front();
  const double width = (edge_sines_.back() - low) / static_cast<double>(cells);
  guesses_per_sine_ = 1.0 / width;
  std::size_t beam = 0;
  for (std::size_t i = 0; i < cells; ++i) {
    const double sine = low + static_cast<double>(i) * width;
    while (beam + 1 < beams() && edge_sines_[beam + 1] <= sine) ++beam;
    beam_guess_.push_back(static_cast<std::uint32_t>(beam));
  }
}

Vec3 Fan::normal_at(double bearing_rad) const {
  return rotation_.rotate({-std::sin(bearing_rad), -std::cos(bearing_rad), 0.0});
}

void Fan::aperture_planes(double low_rad, double high_rad, Vec3& upper, Vec3& lower) const {
  const double middle = 0.5 * (low_rad + high_rad);
  const double width = high_rad - low_rad;
  // The cone z = rho tan(v) over the plane ahead: the mean of 1 / cos over the wedge.
  const double ahead = sin_half_ * (1.0 + width * width / 24);
  const Vec3 level{ahead * std::cos(middle), -ahead * std::sin(middle), 0.0};
  upper = rotation_.rotate(level - Vec3{0.0, 0.0, cos_half_});
  lower = rotation_.rotate(level + Vec3{0.0, 0.0, cos_half_});
}

void Fan::aperture_planes_at(const Vec3& in_sonar, Vec3& upper, Vec3& lower) const {
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  const double scale = sin_half_ / horizontal;
  const Vec3 level{scale * in_sonar.x, scale * in_sonar.y, 0.0};
  upper = rotation_.rotate(level - Vec3{0.0, 0.0, cos_half_});
  lower = rotation_.rotate(level + Vec3{0.0, 0.0, cos_half_});
}

// A voxel without returns but in its nearest and farthest slices: each beam is wholly free or
// wholly not, but for those slices. The planes between beams run through the sonar and do not meet
// inside the voxel, so that the free part is a sum over those that part free from not free.
Fan::Content Fan::free_between_beams(const Vec3& centre, const Extent& extent, const FanPart& where,
                                     const SeenAxes* axes) const {
  const auto is_free = [&](std::size_t j) { return free_limit_m_[j] >= where.far_m - extent.cap; };
  double part = is_free(where.first_beam) ? 1.0 : 0.0;
  double slack = 0.0;
  // A plane's part of the voxel changes by at most this where it is bent.
  const double bent = 2 * extent.warp / extent.edge;
  double unsure = kRounding;
  for (std::size_t j = where.first_beam; j <= where.last_beam; ++j) {
    const double limit = free_limit_m_[j];
    if (limit < where.far_m && limit > where.near_m) slack = kNegligiblePart;
    if (!is_free(j) && limit > where.near_m + extent.cap) return Content::undecided;
    if (j == where.first_beam || is_free(j) == is_free(j - 1)) continue;
    const Vec3& normal = edge_normals_[j];
    const double beyond = part_beyond(axes != nullptr ? axes->of_place(normal) : normal,
                                      dot(normal, centre) / extent.edge);
    unsure += bent;
    part += is_free(j) ? beyond : -beyond;
  }
  // Just half is not more than half, whatever the rounding.
  if (part > kHalf + slack + unsure) return Content::mostly_free;
  // At rest a tie is one to the last digits.
  const double tie = extent.warp > 0 ? -unsure : unsure;
  return part <= kHalf - slack + tie ? Content::less_free : Content::undecided;
}

Fan::Verdict Fan::verdict(const Vec3& centre, const Place& place, const Extent& extent,
                          const SeenAxes* axes) const {
  const double near_m = place.range - extent.inward;
  const double far_m = place.range + extent.outward;
  if (near_m > max_range_ || far_m < min_range_) return {};
  if (place.inside_sides < -extent.level || place.inside_aperture < -extent.aperture) return {};

  const bool clear_of_sides = near_m >= min_range_ && place.inside_sides >= extent.level;
  FanPart where{
      0, beams() - 1, near_m, far_m, place.inside_aperture < extent.aperture, !clear_of_sides};
  where.first_beam = beam_at_sine(place.sine - extent.spread);
  where.last_beam = where.first_beam;
  const double highest = place.sine + extent.spread;
  while (where.last_beam + 1 < beams() && edge_sines_[where.last_beam + 1] <= highest) {
    ++where.last_beam;
  }
  const double least_free = least_free_m_.of(where.first_beam, where.last_beam);
  const double most_free = most_free_m_.of(where.first_beam, where.last_beam);
  if (far_m <= least_free && clear_of_sides) {
    // Free but for the aperture: a cut through the centre would halve the cube.
    if (place.inside_aperture >= extent.aperture) return {Content::all_free, where};
    if (place.inside_aperture > extent.bend) return {Content::mostly_free, where};
    if (place.inside_aperture < -extent.bend) return {Content::less_free, where};
  }
  if (any_return(where.first_beam, where.last_beam, near_m + extent.cap, far_m - extent.cap)) {
    return {Content::undecided, where};
  }
  if (near_m >= most_free) return {};
  // The sphere through the centre halves the cube, but for its bend.
  if (most_free < place.range - extent.warp) return {Content::less_free, where};
  if (extent.cap > 0 && clear_of_sides && !where.cut_by_aperture) {
    const double bend = extent.outward - extent.inward;
    if (least_free > place.range + bend) return {Content::mostly_free, where};
    return {free_between_beams(centre, extent, where, axes), where};
  }
  return {Content::undecided, where};
}

}  // namespace mapperd::map
