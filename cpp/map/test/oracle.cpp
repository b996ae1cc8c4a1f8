#include "oracle.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <thread>
#include <vector>

namespace oracle {

using mapperd::map::PingImage;
using mapperd::Transform;
using mapperd::Vec3;

double weight_of(double intensity, const mapperd::map::IwloParams& p) {
  if (!(intensity > p.intensity_threshold)) return 0.0;
  const double span = p.intensity_max - p.intensity_threshold;
  double x = span <= 1e-9 ? 1.0 : (intensity - p.intensity_threshold) / span;
  x = std::min(std::max(x, 0.0), 1.0);
  return 1.0 / (1.0 + std::exp(-p.sharpness * (x - 0.5)));
}

std::vector<double> edges_of(const PingImage& image) {
  const auto sine = [&](std::size_t j) { return std::sin(image.bearings_rad[j]); };
  std::vector<double> edges;
  edges.push_back(std::asin(sine(0) - (sine(1) - sine(0)) / 2));
  for (std::size_t j = 1; j < image.beams; ++j) {
    edges.push_back(std::asin((sine(j - 1) + sine(j)) / 2));
  }
  const std::size_t last = image.beams - 1;
  edges.push_back(std::asin(sine(last) + (sine(last) - sine(last - 1)) / 2));
  return edges;
}

namespace {

struct Ray {
  std::size_t beam;
  Vec3 direction;  // in the map frame
  double solid_angle;
};

// Dense voxels around the sonar, as far as the ping reaches.
class Grid {
 public:
  Grid(const Vec3& centre, double reach_m, double resolution_m) {
    const auto index = [&](double v) {
      return static_cast<std::int64_t>(std::floor(v / resolution_m));
    };
    first_ = {index(centre.x - reach_m) - 1, index(centre.y - reach_m) - 1,
              index(centre.z - reach_m) - 1};
    edge_ = static_cast<std::int64_t>(2 * reach_m / resolution_m) + 4;
    parts_.resize(static_cast<std::size_t>(edge_ * edge_ * edge_));
  }

  Parts& at(const Voxel& v) {
    return parts_[static_cast<std::size_t>(
        v[0] - first_[0] + edge_ * (v[1] - first_[1] + edge_ * (v[2] - first_[2])))];
  }

  template <typename Visit>
  void for_each(const Visit& visit) const {
    for (std::int64_t i = 0; i < edge_ * edge_ * edge_; ++i) {
      const Parts& parts = parts_[static_cast<std::size_t>(i)];
      if (parts.occupied + parts.free == 0) continue;
      visit({first_[0] + i % edge_, first_[1] + i / edge_ % edge_, first_[2] + i / edge_ / edge_},
            parts);
    }
  }

 private:
  Voxel first_{};
  std::int64_t edge_ = 0;
  std::vector<Parts> parts_;
};

// What lies along a beam up to a range: volumes per unit of solid angle. They are summed up row by
// row once, for all rays of the beam.
class BeamVolumes {
 public:
  BeamVolumes(const PingImage& image, const Settings& settings, std::size_t beam)
      : spacing_m_(image.range_resolution_m) {
    std::size_t first = image.rows;
    for (std::size_t k = image.rows; k-- > 0;) {
      const double far_edge = static_cast<double>(k + 1) * spacing_m_;
      const double intensity = image.at(k, beam);
      const bool above = intensity > settings.iwlo.intensity_threshold;
      rows_.push_back({{}, {above ? 1.0 : 0.0, 0.0, weight_of(intensity, settings.iwlo)}});
      if (above && far_edge > settings.fan.min_range_m) first = k;
    }
    std::reverse(rows_.begin(), rows_.end());
    has_return_ = first < image.rows;
    Parts sum;
    for (std::size_t k = 0; k < rows_.size(); ++k) {
      if (k < first) rows_[k].share = {0.0, 1.0, 0.0};
      rows_[k].nearer = sum;
      sum = until(k, static_cast<double>(k + 1) * spacing_m_);
    }
  }

  bool has_return() const { return has_return_; }

  Parts until(double range_m) const {
    const auto row = static_cast<std::size_t>(range_m / spacing_m_);
    return until(std::min(row, rows_.size() - 1), range_m);
  }

 private:
  struct Row {
    Parts nearer;  // of all rows before it
    Parts share;   // of its own volume
  };

  Parts until(std::size_t k, double range_m) const {
    const double edge_m = static_cast<double>(k) * spacing_m_;
    const double volume = (range_m * range_m * range_m - edge_m * edge_m * edge_m) / 3;
    const Row& row = rows_[k];
    Parts parts = row.nearer;
    parts.occupied += volume * row.share.occupied;
    parts.free += volume * row.share.free;
    parts.weighted += volume * row.share.weighted;
    return parts;
  }

  double spacing_m_;
  std::vector<Row> rows_;
  bool has_return_ = false;
};

class Caster {
 public:
  Caster(const PingImage& image, const Transform& map_T_sonar, const Settings& settings)
      : grid(map_T_sonar.translation, image.max_range_m(), settings.resolution_m),
        image_(image),
        origin_(map_T_sonar.translation),
        settings_(settings) {
    for (std::size_t j = 0; j < image.beams; ++j) beams_.emplace_back(image, settings, j);
  }

  Grid grid;

  // Walks the ray through the voxels it crosses.
  void cast(const Ray& ray) {
    const BeamVolumes& beam = beams_[ray.beam];
    if (!beam.has_return() && !settings_.fan.carve_no_return) return;
    const std::array<double, 3> start{origin_.x, origin_.y, origin_.z};
    const std::array<double, 3> step{ray.direction.x, ray.direction.y, ray.direction.z};
    const double s = settings_.resolution_m;
    double from = settings_.fan.min_range_m;
    Voxel voxel{};
    std::array<double, 3> next{};  // range at which the ray leaves the voxel along each axis
    for (std::size_t i = 0; i < 3; ++i) {
      voxel[i] = static_cast<std::int64_t>(std::floor((start[i] + from * step[i]) / s));
      next[i] = leaving(start[i], step[i], voxel[i]);
    }
    Parts before = beam.until(from);
    while (from < image_.max_range_m()) {
      const std::size_t axis =
          static_cast<std::size_t>(std::min_element(next.begin(), next.end()) - next.begin());
      const double to = std::min(next[axis], image_.max_range_m());
      if (to > from) {
        const Parts after = beam.until(to);
        add(ray, before, after, voxel);
        before = after;
      }
      from = std::max(from, to);
      voxel[axis] += step[axis] > 0 ? 1 : -1;
      next[axis] = leaving(start[axis], step[axis], voxel[axis]);
    }
  }

 private:
  double leaving(double start, double step, std::int64_t voxel) const {
    if (step == 0) return std::numeric_limits<double>::infinity();
    const double face = static_cast<double>(step > 0 ? voxel + 1 : voxel) * settings_.resolution_m;
    return (face - start) / step;
  }

  void add(const Ray& ray, const Parts& before, const Parts& after, const Voxel& voxel) {
    Parts& total = grid.at(voxel);
    total.free += ray.solid_angle * (after.free - before.free);
    total.occupied += ray.solid_angle * (after.occupied - before.occupied);
    total.weighted += ray.solid_angle * (after.weighted - before.weighted);
  }

  const PingImage& image_;
  Vec3 origin_;
  const Settings& settings_;
  std::vector<BeamVolumes> beams_;
};

// Every other beam, so that two casters share the work.
void cast_beams(Caster& caster, std::size_t first_beam, const PingImage& image,
                const Transform& map_T_sonar, const Settings& settings) {
  const double fineness = settings.resolution_m / (settings.rays_per_voxel * image.max_range_m());
  const std::vector<double> edges = edges_of(image);
  const double aperture = settings.fan.vertical_aperture_rad;
  const int elevations = static_cast<int>(std::ceil(aperture / fineness));
  for (std::size_t j = first_beam; j < image.beams; j += 2) {
    const double width = edges[j + 1] - edges[j];
    const int bearings = static_cast<int>(std::ceil(width / fineness));
    for (int ib = 0; ib < bearings; ++ib) {
      const double b = edges[j] + (ib + 0.5) * width / bearings;
      for (int ie = 0; ie < elevations; ++ie) {
        const double e = -aperture / 2 + (ie + 0.5) * aperture / elevations;
        const Vec3 direction{std::cos(e) * std::cos(b), -std::cos(e) * std::sin(b), std::sin(e)};
        const double solid_angle = std::cos(e) * (width / bearings) * (aperture / elevations);
        caster.cast({j, map_T_sonar.rotate(direction), solid_angle});
      }
    }
  }
}

}  // namespace

std::map<Voxel, Parts> parts_of_ping(const PingImage& image, const Transform& map_T_sonar,
                                     const Settings& settings) {
  Caster even(image, map_T_sonar, settings);
  Caster odd(image, map_T_sonar, settings);
  std::thread other([&] { cast_beams(odd, 1, image, map_T_sonar, settings); });
  cast_beams(even, 0, image, map_T_sonar, settings);
  other.join();
  std::map<Voxel, Parts> parts;
  const double volume = std::pow(settings.resolution_m, 3);
  for (const Caster* caster : {&even, &odd}) {
    caster->grid.for_each([&](const Voxel& voxel, const Parts& part) {
      Parts& total = parts[voxel];
      total.occupied += part.occupied / volume;
      total.free += part.free / volume;
      total.weighted += part.weighted / volume;
    });
  }
  return parts;
}

Class class_of(const Parts& parts) {
  if (parts.occupied >= 0.02) return Class::occupied;
  return parts.free > 0.5 ? Class::free : Class::untouched;
}

double distance_to_limit(const Parts& parts) {
  const double occupied = std::abs(parts.occupied - 0.02);
  const double free = std::abs(parts.free - 0.5);
  return parts.occupied >= 0.03 ? occupied : std::min(occupied, free);
}

void update(State& state, const Parts& parts, const Settings& settings) {
  const Class now = class_of(parts);
  if (now == Class::untouched) return;
  const mapperd::map::IwloParams& p = settings.iwlo;
  const double probability = 1.0 / (1.0 + std::exp(-state.log_odds));
  const double alpha = std::max(p.min_alpha, 1.0 / (1.0 + p.decay_rate * state.count));
  double occupied_rate = alpha;
  double free_scale = 1.0;
  if (p.adaptive_update && probability < p.adaptive_threshold) {
    occupied_rate *= probability * p.adaptive_max_ratio / p.adaptive_threshold;
    if (occupied_rate < p.adaptive_min_ratio) occupied_rate = p.adaptive_min_ratio;
  }
  if (p.adaptive_update && p.protect_occupied && probability > 1 - p.adaptive_threshold) {
    const double f = (probability - (1 - p.adaptive_threshold)) / p.adaptive_threshold;
    free_scale = p.adaptive_max_ratio + (1 - p.adaptive_max_ratio) * (1 - f);
  }
  const double free_step = p.L_free * alpha * free_scale;
  double step = free_step;
  if (now == Class::occupied) {
    step = p.L_occ * parts.weight() * occupied_rate;
    if (settings.fan.aggregation == mapperd::map::Aggregation::mean) {
      step = (parts.occupied * step + parts.free * free_step) / (parts.occupied + parts.free);
    }
  }
  state.log_odds = std::min(std::max(state.log_odds + step, p.L_min), p.L_max);
  ++state.count;
}

}  // namespace oracle
