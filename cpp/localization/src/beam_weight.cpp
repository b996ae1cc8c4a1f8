#include "mapperd/localization/beam_weight.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/localization/block_poses.hpp"
#include "mapperd/localization/product.hpp"

namespace mapperd::localization {
namespace {

constexpr double kTails = 8.5;  // sigmas within which the cut of the Gaussian shows in a double

// A reading nearer than expected by more is a short one: rounding of ranges is no evidence.
constexpr double kShorterM = 1e-6;

// 1 over the Gaussian's part within 0 ... max_range.
double hit_norm(const BeamModel& m, double expected_m) {
  const double scale = 1.0 / (std::sqrt(2.0) * m.sigma_hit_m);
  return 2.0 / (std::erf((m.max_range_m - expected_m) * scale) - std::erf(-expected_m * scale));
}

bool is_unsigned(double value) { return value >= 0.0 && std::isfinite(value); }

// One beam for all particles.
struct Reading {
  double range, quality, background;
  double hit;        // z_hit / (sigma sqrt(2 pi))
  double per_m2;     // -1 / (2 sigma^2)
  double short_now;  // z_short lambda exp(-lambda range)
  double lambda;
  double always;  // random or at max_range
};

Reading reading_of(const BeamModel& m, double range_m, double quality) {
  const double range = std::min(range_m, m.max_range_m);
  return {range,
          quality,
          m.background(),
          m.z_hit / (m.sigma_hit_m * std::sqrt(2.0 * kPi)),
          -0.5 / (m.sigma_hit_m * m.sigma_hit_m),
          m.z_short * m.lambda_short_per_m * std::exp(-m.lambda_short_per_m * range),
          m.lambda_short_per_m,
          range < m.max_range_m ? m.z_rand / m.max_range_m : m.z_max};
}

MAPPERD_VECTORISED void mix(const Reading& reading, const double* expected, const double* norms,
                            double* out) {
  const Reading r = reading;
  for (std::size_t i = 0; i < kBlock; ++i) {
    const double off = r.range - expected[i];
    const double hit = r.hit * norms[i] * fast_exp(r.per_m2 * off * off);
    const double cut = 1.0 - fast_exp(-r.lambda * expected[i]);
    const double early = off < -kShorterM ? r.short_now / cut : 0.0;
    const double p = (hit + early) + r.always;
    const double known = expected[i] >= 0.0 ? p : r.background;
    out[i] = r.quality * known + (1.0 - r.quality) * r.background;
  }
}

MAPPERD_VECTORISED void aim(const BlockPoses& poses, double cosine, double sine, double* along_u,
                            double* along_v) {
  for (std::size_t i = 0; i < kBlock; ++i) {
    along_u[i] = poses.cosine[i] * cosine - poses.sine[i] * sine;
    along_v[i] = poses.sine[i] * cosine + poses.cosine[i] * sine;
  }
}

constexpr std::size_t kTogether = kRays / kBlock;  // beams cast at once

// The densities of one block, some beams at once.
class BeamBlock {
 public:
  BeamBlock(const RangeMap& map, const Beams& beams, const BeamModel& model)
      : map_(map),
        beams_(beams),
        model_(model),
        most_(model.max_range_m / map.frame().resolution_m),
        at_limit_(hit_norm(model, model.max_range_m)) {}

  void place(const BlockPoses& poses) {
    poses_ = &poses;
    const double x = beams_.sensor_x_m / map_.frame().resolution_m;
    const double y = beams_.sensor_y_m / map_.frame().resolution_m;
    for (std::size_t k = 0; k < kRays; ++k) {
      const std::size_t i = k % kBlock;
      rays_.u[k] = poses.u[i] + (poses.cosine[i] * x - poses.sine[i] * y);
      rays_.v[k] = poses.v[i] + (poses.sine[i] * x + poses.cosine[i] * y);
    }
  }

  // Of beams first ... first + count - 1, at most kTogether: one row of kBlock each.
  void densities(std::size_t first, std::size_t count, double (*p)[kBlock]) {
    for (std::size_t k = 0; k < count; ++k) {
      const double bearing = beams_.bearing_rad[first + k];
      aim(*poses_, std::cos(bearing), std::sin(bearing), rays_.along_u + k * kBlock,
          rays_.along_v + k * kBlock);
    }
    rays_.count = count * kBlock;
    map_.cast(rays_, most_, expected_);
    for (std::size_t k = 0; k < count; ++k) {
      double* expected = expected_ + k * kBlock;
      scale(expected);
      const Reading reading =
          reading_of(model_, beams_.range_m[first + k], beams_.quality[first + k]);
      mix(reading, expected, norms_, p[k]);
    }
  }

 private:
  // From cells to metres, with the norms of the hits' Gaussian.
  void scale(double* expected) {
    const double tail = kTails * model_.sigma_hit_m;
    for (std::size_t i = 0; i < kBlock; ++i) {
      const bool far = expected[i] >= most_;
      const double metres = expected[i] * map_.frame().resolution_m;
      expected[i] = far ? model_.max_range_m : metres;
      const bool whole = metres > tail && metres < model_.max_range_m - tail;
      norms_[i] = far || metres < 0.0 ? at_limit_ : whole ? 1.0 : hit_norm(model_, metres);
    }
  }

  const RangeMap& map_;
  const Beams& beams_;
  const BeamModel& model_;
  const double most_;
  const double at_limit_;
  const BlockPoses* poses_ = nullptr;
  Rays rays_;
  double expected_[kRays];
  double norms_[kBlock];
};

void cube_sums(BeamBlock& block, std::size_t beams, double* out) {
  double sum[kBlock] = {};
  double p[kTogether][kBlock];
  for (std::size_t first = 0; first < beams; first += kTogether) {
    const std::size_t count = std::min(kTogether, beams - first);
    block.densities(first, count, p);
    for (std::size_t k = 0; k < count; ++k) {
      for (std::size_t i = 0; i < kBlock; ++i) sum[i] += p[k][i] * p[k][i] * p[k][i];
    }
  }
  for (std::size_t i = 0; i < kBlock; ++i) out[i] = std::log(sum[i]);
}

static_assert(kTogether <= kFactors, "products are split once for the beams of one cast");

void products(BeamBlock& block, std::size_t beams, double floor, double kappa, double* out) {
  Products product;
  product.start();
  double p[kTogether][kBlock];
  for (std::size_t first = 0; first < beams; first += kTogether) {
    const std::size_t count = std::min(kTogether, beams - first);
    block.densities(first, count, p);
    for (std::size_t k = 0; k < count; ++k) {
      for (std::size_t i = 0; i < kBlock; ++i) product.mantissa[i] *= std::max(p[k][i], floor);
    }
    product.split_off();
  }
  product.logs(kappa, out);
}

}  // namespace

double BeamModel::background() const { return z_rand / max_range_m; }

double BeamModel::density(double range_m, double expected_m) const {
  const Reading r = reading_of(*this, range_m, 1.0);
  const double off = r.range - expected_m;
  const double hit = r.hit * hit_norm(*this, expected_m) * std::exp(r.per_m2 * off * off);
  const double cut = -std::expm1(-r.lambda * expected_m);
  return hit + (off < -kShorterM ? r.short_now / cut : 0.0) + r.always;
}

void check_beam_model(const BeamModel& m) {
  for (const double z : {m.z_hit, m.z_short, m.z_max, m.z_rand}) {
    if (!(z >= 0.0 && z <= 1.0)) throw std::invalid_argument("weights z must lie in 0 ... 1");
  }
  if (!(m.z_hit + m.z_short + m.z_max + m.z_rand > 0.0)) {
    throw std::invalid_argument("weights z must not all be 0");
  }
  if (!(m.sigma_hit_m >= 1e-6 && m.sigma_hit_m <= 1e6)) {
    throw std::invalid_argument("sigma_hit must lie in 1e-6 ... 1e6 m");
  }
  if (!(m.lambda_short_per_m >= 1e-9 && m.lambda_short_per_m <= 1e9)) {
    throw std::invalid_argument("lambda_short must lie in 1e-9 ... 1e9 1/m");
  }
  if (!(m.max_range_m > 0.0 && m.max_range_m <= 1e9)) {
    throw std::invalid_argument("the largest range must be above 0");
  }
}

void check_beams(const Beams& beams) {
  const std::size_t count = beams.size();
  if (beams.range_m.size() != count || beams.quality.size() != count) {
    throw std::invalid_argument("beams need a bearing, a range and a quality each");
  }
  bool finite = is_finite({beams.sensor_x_m, beams.sensor_y_m, 0.0});
  for (std::size_t j = 0; j < count; ++j) {
    finite = finite && std::isfinite(beams.bearing_rad[j]) && is_unsigned(beams.range_m[j]);
    if (!(beams.quality[j] >= 0.0 && beams.quality[j] <= 1.0)) {
      throw std::invalid_argument("the quality of beams must lie in 0 ... 1");
    }
  }
  if (!finite) throw std::invalid_argument("beams must be finite, ranges not negative");
}

void beam_log_likelihoods(const RangeMap& map, const Beams& beams, const BeamModel& model,
                          BeamAggregation aggregation, double kappa, const Particles& particles,
                          std::size_t first, std::size_t last, double* out) {
  const double peak = model.z_hit / (model.sigma_hit_m * std::sqrt(2.0 * kPi));
  const double floor = std::max(1e-12 * peak, 1e-27);
  const GridTransform to_grid = grid_transform_of(map.frame());
  BeamBlock block(map, beams, model);
  BlockPoses poses;
  double logs[kBlock];
  for (std::size_t start = first; start < last; start += kBlock) {
    const std::size_t count = std::min(kBlock, last - start);
    pose_block(&particles.x[start], &particles.y[start], &particles.yaw[start], count, to_grid,
               poses);
    block.place(poses);
    if (aggregation == BeamAggregation::kCubeSum) {
      cube_sums(block, beams.size(), logs);
    } else {
      products(block, beams.size(), floor, kappa, logs);
    }
    std::copy(logs, logs + count, out + start);
  }
}

}  // namespace mapperd::localization
