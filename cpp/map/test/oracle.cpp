#include "oracle.hpp"

#include <algorithm>
#include <cmath>

#include "scenes.hpp"

namespace oracle {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::PingImage;

namespace {

double overlap(double a_low, double a_high, double b_low, double b_high) {
  return std::max(std::min(a_high, b_high) - std::max(a_low, b_low), 0.0);
}

}  // namespace

Class class_of(const Evidence& evidence) {
  if (evidence.returns >= 0.02) return Class::kOccupied;
  return evidence.free > 0.5 ? Class::kFree : Class::kNothing;
}

double distance_to_limit(const Evidence& evidence) {
  const double occupied = std::abs(evidence.returns - 0.02);
  const double free = std::abs(evidence.free - 0.5);
  return evidence.returns >= 0.03 ? occupied : std::min(occupied, free);
}

double weight_of(double intensity, const mapperd::map::IwloParams& p) {
  if (!(intensity > p.intensity_threshold)) return 0.0;
  const double span = p.intensity_max - p.intensity_threshold;
  double x = span <= 1e-9 ? 1.0 : (intensity - p.intensity_threshold) / span;
  x = std::min(std::max(x, 0.0), 1.0);
  return 1.0 / (1.0 + std::exp(-p.sharpness * (x - 0.5)));
}

PingOracle::PingOracle(const PingImage& image, const Settings& settings, Measure measure)
    : image_(image), settings_(settings), measure_(measure) {
  const auto sine = [&](std::size_t j) { return std::sin(image.bearings_rad[j]); };
  const std::size_t last = image.beams - 1;
  edges_.push_back(std::max(sine(0) - (sine(1) - sine(0)) / 2, -1.0));
  for (std::size_t j = 1; j < image.beams; ++j) edges_.push_back((sine(j - 1) + sine(j)) / 2);
  edges_.push_back(std::min(sine(last) + (sine(last) - sine(last - 1)) / 2, 1.0));
  for (std::size_t j = 0; j < image.beams; ++j) {
    double end = settings.ping.carve_no_return ? image.max_range_m() : 0.0;
    for (std::size_t row = image.rows; row > 0; --row) {
      if (is_return(row - 1, j)) end = static_cast<double>(row - 1) * image.range_resolution_m;
    }
    free_end_m_.push_back(end);
  }
}

// Returns that end before min_range are ignored.
bool PingOracle::is_return(std::size_t row, std::size_t beam) const {
  return static_cast<double>(row + 1) * image_.range_resolution_m > settings_.ping.min_range_m &&
         image_.at(row, beam) > settings_.iwlo.intensity_threshold;
}

std::size_t PingOracle::beam_at(double sine) const {
  std::size_t beam = 0;
  while (beam + 1 < image_.beams && sine >= edges_[beam + 1]) ++beam;
  return beam;
}

double PingOracle::mean_width(double sine) const {
  const std::size_t first = beam_at(sine) / 8 * 8;
  const std::size_t end = std::min(first + 8, image_.beams);
  return (edges_[end] - edges_[first]) / static_cast<double>(end - first);
}

double PingOracle::cosine(double sine) const {
  const std::size_t first = beam_at(sine) / 8 * 8;
  const double middle = (edges_[first] + edges_[std::min(first + 8, image_.beams)]) / 2;
  return std::sqrt(1 - middle * middle);
}

double PingOracle::place_of(double sine) const {
  const std::size_t beam = beam_at(sine);
  return static_cast<double>(beam) + (sine - edges_[beam]) / (edges_[beam + 1] - edges_[beam]);
}

double PingOracle::sine_at(double place) const {
  const double last = static_cast<double>(image_.beams - 1);
  const auto beam = static_cast<std::size_t>(std::clamp(std::floor(place), 0.0, last));
  return edges_[beam] + (place - static_cast<double>(beam)) * (edges_[beam + 1] - edges_[beam]);
}

double PingOracle::half_width(double range_m, double sine) const {
  return 0.54 * settings_.edge_m * cosine(sine) / range_m / mean_width(sine);
}

Evidence PingOracle::at(double range_m, double sine) const {
  const double a = 0.54 * settings_.edge_m;
  const bool by_sine = measure_ == Measure::kSine;
  const double b = by_sine ? a * cosine(sine) / range_m : half_width(range_m, sine);
  const double middle = by_sine ? sine : place_of(sine);
  const double near = std::max(range_m - a, settings_.ping.min_range_m), far = range_m + a;
  const double row_m = image_.range_resolution_m;
  const auto first_row = static_cast<std::size_t>(std::max(near / row_m - 1, 0.0));
  Evidence sum;
  for (std::size_t j = 0; j < image_.beams; ++j) {
    const double low = by_sine ? edges_[j] : static_cast<double>(j);
    const double high = by_sine ? edges_[j + 1] : static_cast<double>(j + 1);
    const double across = overlap(middle - b, middle + b, low, high) / (2 * b);
    if (!(across > 0)) continue;
    sum.free += across * overlap(near, far, near, free_end_m_[j]) / (2 * a);
    for (std::size_t row = first_row; row < image_.rows; ++row) {
      const double begin_m = static_cast<double>(row) * row_m;
      if (begin_m > far) break;
      if (!is_return(row, j)) continue;
      const double part = across * overlap(near, far, begin_m, begin_m + row_m) / (2 * a);
      sum.returns += part;
      sum.weighted += part * weight_of(image_.at(row, j), settings_.iwlo);
    }
  }
  return sum;
}

double PingOracle::inside_aperture(const Vec3& v) const {
  const double half = settings_.ping.vertical_aperture_rad / 2;
  return (std::hypot(v.x, v.y) * std::sin(half) - std::abs(v.z) * std::cos(half)) /
         settings_.edge_m;
}

double PingOracle::sine_of(const Vec3& v) { return -v.y / std::hypot(v.x, v.y); }

Evidence PingOracle::at(const Vec3& v) const {
  const double inside = inside_aperture(v);
  if (!(v.x > 0) || inside <= -0.5) return {};
  const Evidence evidence = at(norm(v), sine_of(v));
  return inside <= 0 && class_of(evidence) != Class::kOccupied ? Evidence{} : evidence;
}

Evidence PingOracle::volume(const Vec3& centre, const Transform& map_T_sonar, int n,
                            std::uint64_t seed) const {
  scenes::Random random(seed);
  const double half = settings_.ping.vertical_aperture_rad / 2;
  const double step = settings_.edge_m / n;
  Evidence sum;
  for (int i = 0; i < n * n * n; ++i) {
    const auto along = [&](int k) {
      return step * (k + random.uniform(0, 1)) - settings_.edge_m / 2;
    };
    const Vec3 offset{along(i % n), along(i / n % n), along(i / n / n)};
    const Vec3 v = centre + map_T_sonar.rotate_back(offset);
    const double range = norm(v), sine = sine_of(v);
    if (!(v.x > 0) || range < settings_.ping.min_range_m || range >= image_.max_range_m() ||
        std::abs(v.z) > range * std::sin(half) || sine < edges_.front() || sine >= edges_.back()) {
      continue;
    }
    const std::size_t beam = beam_at(sine);
    const auto row = static_cast<std::size_t>(range / image_.range_resolution_m);
    if (range < free_end_m_[beam]) sum.free += 1;
    if (row >= image_.rows || !is_return(row, beam)) continue;
    sum.returns += 1;
    sum.weighted += weight_of(image_.at(row, beam), settings_.iwlo);
  }
  const double all = n * n * n;
  return {sum.returns / all, sum.free / all, sum.weighted / all};
}

void update(State& state, const Evidence& evidence, const Settings& settings) {
  const Class now = class_of(evidence);
  if (now == Class::kNothing) return;
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
  if (now == Class::kOccupied) {
    step = p.L_occ * evidence.weight() * occupied_rate;
    if (settings.ping.aggregation == mapperd::map::Aggregation::kMean) {
      step = (evidence.returns * step + evidence.free * free_step) /
             (evidence.returns + evidence.free);
    }
  }
  state.log_odds = std::min(std::max(state.log_odds + step, p.L_min), p.L_max);
  ++state.count;
}

}  // namespace oracle
