#include "mapperd/map/arc_model.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::map {
namespace {

// Uncertainty of a pooled level: quantisation, and a sample that the neighbouring arc holds.
constexpr double kLevelFactor = 1.15;
constexpr double kLevelStep = 0.015;
// Log-uniform levels of the broad share.
constexpr double kBroadLow = 0.045;
constexpr double kBroadHigh = 7.5;
// The tail of pooled noise in open water, over its median.
constexpr double kNoiseScale = 3.5;
constexpr double kNoiseExponent = 1.82;
constexpr double kNoiseStep = 0.5;  // of quantisation, in medians of the noise
// The two-way pattern is taken at this part of the elevation: the voxels of an arc are not points.
constexpr double kPatternScale = 0.9;
constexpr double kHalfPowerSinc = 0.44295;

constexpr int kLevelsPerOctave = 12;

double gaussian_below(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

void require(bool ok, const char* what) {
  if (!ok) throw std::invalid_argument(what);
}

double noise_below(double level) {
  return level <= kNoiseScale ? 0.0 : 1.0 - std::pow(level / kNoiseScale, -kNoiseExponent);
}

double level_of(int index) {
  return std::exp2((index - ArcModel::kUnitLevel) / double{kLevelsPerOctave});
}

double broad_below(double level) {
  const double place =
      std::log(std::max(level, 1e-6) / kBroadLow) / std::log(kBroadHigh / kBroadLow);
  return std::clamp(place, 0.0, 1.0);
}

constexpr float kLog2E = 1.44269504F;

MAPPERD_VECTORISED void find_log_misses(std::size_t count, const std::int16_t* units,
                                        const std::uint16_t* place, const float* probability,
                                        const float* below, float* out) {
  for (std::size_t i = 0; i < count; ++i) {
    out[i] = fast_log(1.0F - probability[units[i]] * (1.0F - below[place[i]]));
  }
}

// What the other sources of the arcs leave below a level: `miss` becomes it.
MAPPERD_VECTORISED void find_others(std::size_t count, const std::uint8_t* noise,
                                    const float* noise_below, const float* sum, float* miss) {
  for (std::size_t i = 0; i < count; ++i) {
    const float others = sum[i] - miss[i];
    miss[i] = noise_below[noise[i]] * fast_exp2(kLog2E * (others < 0.0F ? others : 0.0F));
  }
}

MAPPERD_VECTORISED void find_steps(std::size_t count, const std::uint16_t* place,
                                   const float* below_upper, const float* below_lower,
                                   const float* upper, const float* lower, float most,
                                   float* step) {
  constexpr float kLeast = 1e-12F;
  for (std::size_t i = 0; i < count; ++i) {
    const float occupied = below_upper[place[i]] * upper[i] - below_lower[place[i]] * lower[i];
    const float empty = upper[i] - lower[i];
    const float ratio =
        fast_log(occupied > kLeast ? occupied : kLeast) - fast_log(empty > kLeast ? empty : kLeast);
    const float found = ratio < -most ? -most : (ratio > most ? most : ratio);
    step[i] = empty < kLeast ? (occupied > kLeast ? most : 0.0F) : found;
  }
}

}  // namespace

ArcModel::ArcModel(const ArcParams& params, const IwloRule& rule)
    : params_(params), min_units_(rule.min_units()) {
  require(params.half_aperture_rad > 0 && params.half_aperture_rad < 1.0,
          "half_aperture_rad must lie between 0 and 1");
  require(params.beam_width_rad > 0 && params.beam_width_rad < 2.0,
          "beam_width_rad must lie between 0 and 2");
  require(params.spread_below > 0 && params.spread_above > 0 && params.spread_above < 100 &&
              params.spread_below < 100,
          "spread_below and spread_above must lie between 0 and 100");
  require(params.broad_share >= 0 && params.broad_share < 1, "broad_share must lie in [0, 1)");
  require(params.missed_share > 0 && params.missed_share < 1, "missed_share must lie in (0, 1)");
  require(params.first_return > 0 && params.quiet > 0 && std::isfinite(params.first_return) &&
              std::isfinite(params.quiet),
          "first_return and quiet must be positive numbers");
  require(params.behind_scale >= 0 && params.behind_scale <= 1, "behind_scale must lie in [0, 1]");
  require(params.min_step >= 0 && params.max_step > 0 && params.max_step <= kMaxLogOdds,
          "min_step must be 0 or more, and max_step between 0 and 127");
  const double sin_half = std::sin(params.half_aperture_rad);
  upper_.resize(kLevels * kElevations);
  lower_.resize(kLevels * kElevations);
  for (int level = 0; level < kLevels; ++level) {
    const double x = level_of(level);
    const double upper = kLevelFactor * x + kLevelStep;
    const double lower = std::max(x / kLevelFactor - kLevelStep, 1e-6);
    for (int e = 0; e < kElevations; ++e) {
      const double sine = (e + 0.5) / kElevations * sin_half;
      upper_[place(level, e)] = static_cast<float>(below(upper, sine));
      lower_[place(level, e)] = static_cast<float>(below(lower, sine));
    }
  }
  for (int level = 0; level < kNoiseLevels; ++level) {
    const double x = std::exp2(level / double{kLevelsPerOctave});
    noise_upper_.push_back(static_cast<float>(noise_below(kLevelFactor * x + kNoiseStep)));
    noise_lower_.push_back(static_cast<float>(noise_below(x / kLevelFactor - kNoiseStep)));
  }
  const int span = rule.max_units() - rule.min_units();
  probability_.reserve(static_cast<std::size_t>(span) + 1);
  for (int i = 0; i <= span; ++i) {
    const double log_odds = rule.log_odds(static_cast<std::int16_t>(rule.min_units() + i));
    probability_.push_back(static_cast<float>(1.0 / (1.0 + std::exp(-log_odds))));
  }
}

double ArcModel::pattern(double sine) const {
  const double stretch = kHalfPowerSinc / std::sin(params_.beam_width_rad / 2.0);
  const double x = std::max(3.14159265358979323846 * stretch * kPatternScale * sine, 1e-9);
  const double sinc = std::sin(x) / x;
  return std::max(sinc * sinc, 1e-4);
}

double ArcModel::below(double level, double sine) const {
  const double z = std::log(level / pattern(sine));
  const double narrow = gaussian_below(z / (z < 0 ? params_.spread_below : params_.spread_above));
  const double found =
      (1 - params_.broad_share) * narrow + params_.broad_share * broad_below(level);
  return params_.missed_share + (1 - params_.missed_share) * found;
}

// Of a quiet level far below that of a surface.
double ArcModel::free_step(const ArcParams& params) {
  constexpr double kQuietLevel = 0.1;
  const double found = params.broad_share * broad_below(kQuietLevel);
  return -std::log(params.missed_share + (1 - params.missed_share) * found);
}

double ArcModel::heard_up_to(double noise) const {
  const double quiet = kLevelFactor * params_.quiet * noise + kLevelStep;
  const double sin_half = std::sin(params_.half_aperture_rad);
  const double most = params_.missed_share + 0.25;
  double heard = 0.0;
  for (int e = 0; e < kElevations; ++e) {
    const double sine = (e + 0.5) / kElevations * sin_half;
    if (below(quiet, sine) > most) break;
    heard = (e + 1.0) / kElevations * sin_half;
  }
  return std::asin(heard);
}

int ArcModel::index_of_noise(float level) {
  const float octaves = fast_log(std::max(level, 1e-6F)) * kLog2E;
  return static_cast<int>(std::floor(octaves * kLevelsPerOctave + (kUnitLevel + 0.5F)));
}

int ArcModel::index_of_level(float level) {
  return std::clamp(index_of_noise(level), 0, kLevels - 1);
}

void ArcModel::log_misses(const Voxels& voxels, float* upper, float* lower) const {
  const float* const probability = probability_.data() - min_units_;
  find_log_misses(voxels.count, voxels.units, voxels.place, probability, upper_.data(), upper);
  find_log_misses(voxels.count, voxels.units, voxels.place, probability, lower_.data(), lower);
}

void ArcModel::steps(const Voxels& voxels, float* upper, float* lower, const float* sum_upper,
                     const float* sum_lower, float* step) const {
  find_others(voxels.count, voxels.noise, noise_upper_.data(), sum_upper, upper);
  find_others(voxels.count, voxels.noise, noise_lower_.data(), sum_lower, lower);
  find_steps(voxels.count, voxels.place, upper_.data(), lower_.data(), upper, lower,
             static_cast<float>(params_.max_step), step);
}

}  // namespace mapperd::map
