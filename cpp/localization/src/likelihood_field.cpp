#include "mapperd/localization/likelihood_field.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/distance_transform.hpp"

namespace mapperd::localization {
namespace {

constexpr std::size_t kMaxCells = std::size_t{1} << 30;  // places are 32-bit

bool touches_free(const OccupancyGrid& grid, std::size_t row, std::size_t column) {
  const GridFrame& f = grid.frame;
  return (row > 0 && grid.is(row - 1, column, kFree)) ||
         (row + 1 < f.rows && grid.is(row + 1, column, kFree)) ||
         (column > 0 && grid.is(row, column - 1, kFree)) ||
         (column + 1 < f.columns && grid.is(row, column + 1, kFree));
}

std::vector<std::uint8_t> obstacles(const OccupancyGrid& grid, bool only_boundaries) {
  std::vector<std::uint8_t> marked(grid.cells.size());
  for (std::size_t r = 0; r < grid.frame.rows; ++r) {
    for (std::size_t c = 0; c < grid.frame.columns; ++c) {
      const bool wanted =
          grid.is(r, c, kOccupied) && (!only_boundaries || touches_free(grid, r, c));
      marked[r * grid.frame.columns + c] = wanted ? 1 : 0;
    }
  }
  return marked;
}

// p of squared distances in cells; kBeyond is at the truncation.
MAPPERD_VECTORISED void densities(const std::int32_t* squared, std::size_t count,
                                  const double* factors, float* out) {
  const double per_cell = factors[0];  // exponent of one squared cell
  const double least = factors[1];     // exponent at the truncation
  const double peak = factors[2];
  const double rest = factors[3];
  for (std::size_t i = 0; i < count; ++i) {
    const double power = per_cell * static_cast<double>(squared[i]);
    out[i] = static_cast<float>(peak * fast_exp(power > least ? power : least) + rest);
  }
}

double peak_of(const HitModel& m) { return m.z_hit / (m.sigma_hit_m * std::sqrt(2.0 * kPi)); }

}  // namespace

double HitModel::density(double distance_m) const {
  const double d = std::min(distance_m, max_distance_m) / sigma_hit_m;
  return peak_of(*this) * std::exp(-0.5 * d * d) + z_rand / max_range_m;
}

void check_hit_model(const HitModel& m) {
  const bool weights = m.z_hit >= 0.0 && m.z_rand >= 0.0 && m.z_hit <= 1.0 && m.z_rand <= 1.0;
  if (!weights) throw std::invalid_argument("z_hit and z_rand must lie in 0 ... 1");
  if (!(m.sigma_hit_m >= 1e-6 && m.sigma_hit_m <= 1e6)) {
    throw std::invalid_argument("sigma_hit must lie in 1e-6 ... 1e6 m");
  }
  if (!(m.max_range_m > 0.0 && m.max_range_m <= 1e9)) {
    throw std::invalid_argument("the largest range must be above 0");
  }
  if (!(m.max_distance_m >= 0.0 && m.max_distance_m <= 1e9)) {
    throw std::invalid_argument("likelihood_max_dist must not be negative");
  }
  if (!(peak_of(m) + m.z_rand / m.max_range_m > 1e-15)) {
    throw std::invalid_argument("z_hit and z_rand must not both be 0");
  }
}

LikelihoodField::LikelihoodField(const OccupancyGrid& grid, const HitModel& model,
                                 const ObstacleParams& rule, int threads)
    : frame_(grid.frame) {
  check_frame(frame_);
  check_hit_model(model);
  if (grid.cells.size() != frame_.cells()) throw std::invalid_argument("cells are missing");
  set_outside(model.density(model.max_distance_m));
  allocate(1);
  const double limit = std::ceil(model.max_distance_m / frame_.resolution_m);
  const std::vector<std::int32_t> squared =
      squared_distances(obstacles(grid, rule.only_boundaries), frame_.rows, frame_.columns,
                        static_cast<std::int32_t>(std::min(limit, 1e6)), threads);
  const double per_m2 = -0.5 / (model.sigma_hit_m * model.sigma_hit_m);
  const double factors[] = {per_m2 * frame_.resolution_m * frame_.resolution_m,
                            per_m2 * model.max_distance_m * model.max_distance_m, peak_of(model),
                            model.z_rand / model.max_range_m};
  const double unknown =
      rule.unknown == UnknownSpace::kUniform ? 1.0 / model.max_range_m : background_;
  const std::vector<std::uint8_t> hits = obstacles(grid, rule.only_boundaries);
  for (std::size_t r = 0; r < frame_.rows; ++r) {
    const std::size_t start = r * frame_.columns;
    densities(&squared[start], frame_.columns, factors, row(0, r));
    if (rule.unknown == UnknownSpace::kAsFree) continue;
    for (std::size_t c = 0; c < frame_.columns; ++c) {
      const std::int8_t cell = grid.cells[start + c];
      const bool is_inside = cell == kOccupied && hits[start + c] == 0;
      const bool is_known = cell == kFree || cell == kOccupied;
      if (!is_known || is_inside) row(0, r)[c] = static_cast<float>(unknown);
    }
  }
  raise_to_floor();
}

LikelihoodField::LikelihoodField(const GridFrame& frame, const std::vector<float>& values,
                                 double outside)
    : frame_(frame) {
  check_frame(frame_);
  if (values.size() != frame_.cells()) throw std::invalid_argument("values are missing");
  const bool fit =
      std::all_of(values.begin(), values.end(), [](float v) { return v >= 0.0F && v <= 1e15F; });
  if (!fit || !(outside >= 0.0 && outside <= 1e15)) {
    throw std::invalid_argument("likelihoods must be finite and not negative");
  }
  set_outside(outside);
  allocate(1);
  for (std::size_t r = 0; r < frame_.rows; ++r) {
    const float* from = &values[r * frame_.columns];
    std::copy(from, from + frame_.columns, row(0, r));
  }
  raise_to_floor();
}

LikelihoodField::LikelihoodField(const std::vector<float>& distances_m,
                                 const std::array<std::size_t, 3>& size,
                                 const std::array<double, 3>& first_centre_m, double resolution_m,
                                 const HitModel& model)
    : flat_(false) {
  const double half = 0.5 * resolution_m;
  frame_ = {
      size[1], size[0], resolution_m, {first_centre_m[0] - half, first_centre_m[1] - half, 0.0}};
  check_frame(frame_);
  check_hit_model(model);
  if (size[2] == 0 || distances_m.size() != size[0] * size[1] * size[2] ||
      !std::isfinite(first_centre_m[2])) {
    throw std::invalid_argument("distances are missing");
  }
  lowest_z_m_ = first_centre_m[2] - half;
  set_outside(model.density(model.max_distance_m));
  allocate(size[2]);
  for (std::size_t x = 0; x < size[0]; ++x) {
    for (std::size_t y = 0; y < size[1]; ++y) {
      const float* column = &distances_m[(x * size[1] + y) * size[2]];
      for (std::size_t z = 0; z < size[2]; ++z) {
        const double distance = std::isnan(column[z]) ? model.max_distance_m : column[z];
        row(z, y)[x] = static_cast<float>(model.density(distance));
      }
    }
  }
  raise_to_floor();
}

// As cells hold it: what is outside and what is far have one value.
void LikelihoodField::set_outside(double value) {
  outside_ = static_cast<float>(value);
  background_ = static_cast<double>(outside_);
}

void LikelihoodField::allocate(std::size_t layers) {
  layers_ = layers;
  if ((layers + 1) * layer_cells() > kMaxCells) {
    throw std::invalid_argument("the likelihood field must have at most 2^30 cells");
  }
  values_.assign((flat_ ? layers : layers + 1) * layer_cells(), outside_);
}

float* LikelihoodField::row(std::size_t layer, std::size_t row) {
  return &values_[layer * layer_cells() + (row + 1) * (frame_.columns + 2) + 1];
}

void LikelihoodField::raise_to_floor() {
  const float largest = *std::max_element(values_.begin(), values_.end());
  const float floor = std::max(1e-12F * largest, 1e-27F);
  for (float& value : values_) value = std::max(value, floor);
  background_ = std::max(background_, static_cast<double>(floor));
}

std::int32_t LikelihoodField::layer_at(double z_m) const {
  if (flat_) return 0;
  const double layer = std::floor((z_m - lowest_z_m_) / frame_.resolution_m);
  const bool within = layer >= 0.0 && layer < static_cast<double>(layers_);
  const std::size_t chosen = within ? static_cast<std::size_t>(layer) : layers_;
  return static_cast<std::int32_t>(chosen * layer_cells());
}

float LikelihoodField::at(std::size_t layer, std::size_t row, std::size_t column) const {
  return values_[layer * layer_cells() + (row + 1) * (frame_.columns + 2) + column + 1];
}

}  // namespace mapperd::localization
