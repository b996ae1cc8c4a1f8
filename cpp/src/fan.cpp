#include "mapperd/fan.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

namespace mapperd {
namespace {

constexpr double kHalfPi = 1.5707963267948966;
constexpr double kMaxCells = 64.0 * 1024 * 1024;  // far above 16 MiB of any real message
constexpr double kMaxRange = 10000.0;

void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(what);
}

const double kHalfDiagonal = std::sqrt(3.0) / 2;  // of a unit cube

}  // namespace

void check_ping(const PingImage& image, const FanSettings& settings) {
  require(image.rows >= 1 && image.beams >= 2,
          "intensity must have at least one row and two beams");
  require(static_cast<double>(image.rows) * static_cast<double>(image.beams) <= kMaxCells,
          "intensity has more than 2^26 samples");
  require(std::isfinite(image.range_resolution_m) && image.range_resolution_m > 0,
          "range_resolution_m must be finite and positive");
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
         const Transform& map_T_sonar)
    : row_count_(image.rows),
      resolution_(image.range_resolution_m),
      min_range_(settings.min_range_m),
      max_range_(image.max_range_m()),
      sin_half_(std::sin(settings.vertical_aperture_rad / 2)),
      cos_half_(std::cos(settings.vertical_aperture_rad / 2)),
      carve_no_return_(settings.carve_no_return),
      rotation_{map_T_sonar.rows, {}},
      edges_(beam_edges(image.bearings_rad, image.beams)),
      free_limit_m_(image.beams, 0.0),
      returns_before_(image.beams * (image.rows + 1)) {
  for (const double edge : edges_) edge_normals_.push_back(normal_at(edge));
  std::vector<std::size_t> ends;
  for (std::size_t j = 0; j < image.beams; ++j) {
    fill_beam(image, rule, j);
    ends.push_back(pieces_.size());
  }
  for (std::size_t j = 0; j < image.beams; ++j) {
    if (free_limit_m_[j] > min_range_) {
      RadialBuilder free(pieces_);
      free.add(min_range_, {1.0, 1.0});
      free.add(free_limit_m_[j], {});
    }
    ends.push_back(pieces_.size());
  }
  link_profiles(image.beams, ends);
}

void Fan::fill_beam(const PingImage& image, const IwloRule& rule, std::size_t j) {
  std::uint32_t* before = &returns_before_[j * (row_count_ + 1)];
  RadialBuilder builder(pieces_);
  std::size_t end_row = 0;
  for (std::size_t k = 0; k < row_count_; ++k) {
    // A row partly nearer than min_range counts with the part beyond.
    const double far_edge = static_cast<double>(k + 1) * resolution_;
    const bool is_return = far_edge > min_range_ && rule.is_return(image.at(k, j));
    before[k + 1] = before[k] + (is_return ? 1 : 0);
    if (!is_return) continue;
    const double near_edge = std::max(static_cast<double>(k) * resolution_, min_range_);
    if (before[k] == 0) {
      free_limit_m_[j] = near_edge;
    } else if (end_row < k) {
      builder.add(static_cast<double>(end_row) * resolution_, {});
    }
    builder.add(near_edge, {1.0, rule.occupied_weight(image.at(k, j))});
    end_row = k + 1;
  }
  if (end_row > 0) {
    builder.add(static_cast<double>(end_row) * resolution_, {});
  } else if (carve_no_return_) {
    free_limit_m_[j] = max_range_;
  }
}

void Fan::link_profiles(std::size_t beams, const std::vector<std::size_t>& ends) {
  std::size_t begin = 0;
  for (std::size_t i = 0; i < 2 * beams; ++i) {
    auto& profiles = i < beams ? returns_ : free_space_;
    const double spacing = i < beams ? resolution_ : 0.0;
    profiles.emplace_back(pieces_.data() + begin, ends[i] - begin, spacing);
    begin = ends[i];
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

bool Fan::any_return(std::size_t first, std::size_t last, double near_m, double far_m) const {
  const auto row_of = [this](double range) {
    const double row = std::clamp(range / resolution_, 0.0, static_cast<double>(row_count_));
    return static_cast<std::size_t>(row);
  };
  // A hair of slack swallows the rounding of the division.
  const double slack = 1e-9 * max_range_;
  const std::size_t from = row_of(near_m - slack);
  const std::size_t end = std::min(row_of(far_m + slack) + 1, row_count_);
  for (std::size_t j = first; j <= last; ++j) {
    const std::uint32_t* before = &returns_before_[j * (row_count_ + 1)];
    if (before[end] != before[from]) return true;
  }
  return false;
}

// How far a cube reaches from its centre, along the directions that matter.
struct Fan::Extent {
  double inward;    // towards the sonar
  double outward;   // away from it
  double sideways;  // in bearing, horizontally
  double forward;   // horizontally towards and away from the sonar's vertical axis
  double aperture;  // across the nearer of the aperture's cones
  double bend;      // by how much that cone departs from a plane inside the cube
};

// Support widths of the cube, plus what the curvature of spheres and cones adds. Beside the sonar,
// where directions change within the cube, those of the ball around it.
Fan::Extent Fan::extent_of(const Vec3& in_sonar, double edge_m) const {
  const double radius = kHalfDiagonal * edge_m;
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  if (horizontal < 2 * radius) return {radius, radius, radius, radius, radius, radius};
  const auto width = [&](const Vec3& direction) {
    const Vec3 d = rotation_.rotate(direction);
    return 0.5 * edge_m * (std::abs(d.x) + std::abs(d.y) + std::abs(d.z));
  };
  const Vec3 ahead{in_sonar.x / horizontal, in_sonar.y / horizontal, 0.0};
  // The square to the nearer of the aperture's cones, as it is in the centre's half-plane.
  const double up = std::copysign(cos_half_, in_sonar.z);
  const Vec3 across_cone{-ahead.x * sin_half_, -ahead.y * sin_half_, up};
  // A horizontal offset d to the side lengthens the distance from the vertical axis by d^2 / 2.
  const double bend = radius * radius / (2 * (horizontal - radius));
  Extent extent{};
  extent.inward = width((1.0 / norm(in_sonar)) * in_sonar);
  extent.outward = extent.inward + bend;
  extent.sideways = width({-ahead.y, ahead.x, 0.0});
  extent.forward = width(ahead) + bend;
  extent.bend = bend * sin_half_;
  extent.aperture = width(across_cone) + extent.bend;
  // Both cones cross a cube where the fan is thin: the centre decides nothing there.
  if (horizontal * sin_half_ < 2 * radius) extent.bend = extent.aperture = radius;
  return extent;
}

Fan::Verdict Fan::verdict(const Vec3& centre, double edge_m) const {
  const Vec3 in_sonar = rotation_.rotate_back(centre);
  const double horizontal = std::sqrt(in_sonar.x * in_sonar.x + in_sonar.y * in_sonar.y);
  const double range = norm(centre);
  const Extent extent = extent_of(in_sonar, edge_m);
  const double near_m = range - extent.inward;
  const double far_m = range + extent.outward;
  if (near_m > max_range_ || far_m < min_range_) return {};
  const double inside_aperture = horizontal * sin_half_ - std::abs(in_sonar.z) * cos_half_;
  const double inside_sides =
      std::min(dot(edge_normals_.front(), centre), -dot(edge_normals_.back(), centre));
  // Any horizontal direction: the outermost planes are not square to the centre's bearing.
  const double level = std::max(extent.sideways, extent.forward) * 1.4142135623730951;
  if (inside_sides < -level || inside_aperture < -extent.aperture) return {};

  FanPart where{0, beams() - 1, near_m, far_m, inside_aperture < extent.aperture};
  if (horizontal > extent.forward) {
    const double bearing = std::atan2(-in_sonar.y, in_sonar.x);
    const double spread = std::atan(extent.sideways / (horizontal - extent.forward));
    const auto beam_at = [this](double b) {
      const auto above = std::upper_bound(edges_.begin() + 1, edges_.end() - 1, b);
      return static_cast<std::size_t>(above - edges_.begin() - 1);
    };
    where.first_beam = beam_at(bearing - spread);
    where.last_beam = beam_at(bearing + spread);
  }
  double least_free = max_range_;
  double most_free = 0.0;
  for (std::size_t j = where.first_beam; j <= where.last_beam; ++j) {
    least_free = std::min(least_free, free_limit_m_[j]);
    most_free = std::max(most_free, free_limit_m_[j]);
  }
  if (far_m <= least_free && near_m >= min_range_ && inside_sides >= level) {
    // Free but for the aperture: a cut through the centre would halve the cube.
    if (inside_aperture >= extent.aperture) return {Content::all_free, where};
    if (inside_aperture > extent.bend) return {Content::mostly_free, where};
    if (inside_aperture < -extent.bend) return {Content::less_free, where};
  }
  if (near_m >= most_free && !any_return(where.first_beam, where.last_beam, near_m, far_m)) {
    return {};
  }
  return {Content::undecided, where};
}

}  // namespace mapperd
