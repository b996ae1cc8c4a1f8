#include "mapperd/localization/field_weight.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/localization/block_poses.hpp"
#include "mapperd/localization/product.hpp"

namespace mapperd::localization {
namespace {

// One end of a beam, in cells, for all particles of a block.
struct End {
  double x, y;
  const float* layer;
};

// The field's values at one end of a beam, for a block; what is not a number lies outside.
MAPPERD_INLINE void look_up(const BlockPoses& p, const End& end, double last_u, double last_v,
                            std::int32_t stride, float* out) {
  for (std::size_t i = 0; i < kBlock; ++i) {
    double u = p.u[i] + (p.cosine[i] * end.x - p.sine[i] * end.y);
    double v = p.v[i] + (p.sine[i] * end.x + p.cosine[i] * end.y);
    u = u > 0.0 ? u : 0.0;
    v = v > 0.0 ? v : 0.0;
    u = u < last_u ? u : last_u;
    v = v < last_v ? v : last_v;
    out[i] = end.layer[static_cast<std::int32_t>(v) * stride + static_cast<std::int32_t>(u)];
  }
}

// What all blocks share.
struct Task {
  std::vector<End> ends;
  std::vector<double> quality;
  std::size_t fan;
  double background;
  double last_u, last_v;
  std::int32_t stride;
};

MAPPERD_INLINE void likeliest(const BlockPoses& poses, const Task& task, std::size_t beam,
                              float* best) {
  const End* ends = &task.ends[beam * task.fan];
  look_up(poses, ends[0], task.last_u, task.last_v, task.stride, best);
  float other[kBlock];
  for (std::size_t k = 1; k < task.fan; ++k) {
    look_up(poses, ends[k], task.last_u, task.last_v, task.stride, other);
    for (std::size_t i = 0; i < kBlock; ++i) best[i] = best[i] > other[i] ? best[i] : other[i];
  }
}

MAPPERD_VECTORISED void cube_sums(const BlockPoses& poses, const Task& task, double* out) {
  double sum[kBlock] = {};
  float p[kBlock];
  for (std::size_t beam = 0; beam < task.quality.size(); ++beam) {
    likeliest(poses, task, beam, p);
    const double q = task.quality[beam];
    const double rest = (1.0 - q) * task.background;
    for (std::size_t i = 0; i < kBlock; ++i) {
      const double mixed = q * static_cast<double>(p[i]) + rest;
      sum[i] += mixed * mixed * mixed;
    }
  }
  for (std::size_t i = 0; i < kBlock; ++i) out[i] = fast_log(1.0 + sum[i]);
}

MAPPERD_VECTORISED void products(const BlockPoses& poses, const Task& task, double kappa,
                                 double* out) {
  Products product;
  product.start();
  float p[kBlock];
  for (std::size_t beam = 0; beam < task.quality.size(); ++beam) {
    likeliest(poses, task, beam, p);
    const double q = task.quality[beam];
    const double rest = (1.0 - q) * task.background;
    for (std::size_t i = 0; i < kBlock; ++i) {
      product.mantissa[i] *= q * static_cast<double>(p[i]) + rest;
    }
    if ((beam + 1) % kFactors == 0) product.split_off();
  }
  product.logs(kappa, out);
}

Task task_of(const LikelihoodField& field, const Endpoints& ends, const GridTransform& to_grid) {
  Task task{{},
            ends.quality,
            ends.fan,
            field.background(),
            to_grid.last_u,
            to_grid.last_v,
            field.stride()};
  const double per_cell = 1.0 / field.frame().resolution_m;
  task.ends.reserve(ends.x_m.size());
  for (std::size_t k = 0; k < ends.x_m.size(); ++k) {
    const std::int32_t layer = ends.z_m.empty() ? 0 : field.layer_at(ends.z_m[k]);
    task.ends.push_back({ends.x_m[k] * per_cell, ends.y_m[k] * per_cell, field.values() + layer});
  }
  return task;
}

bool all_finite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

}  // namespace

void check_endpoints(const Endpoints& ends) {
  const std::size_t wanted = ends.beams() * ends.fan;
  const bool heights = ends.z_m.empty() || ends.z_m.size() == wanted;
  if (ends.fan == 0 || ends.x_m.size() != wanted || ends.y_m.size() != wanted || !heights) {
    throw std::invalid_argument("a scan needs as many ends of beams as beams times elevations");
  }
  if (!all_finite(ends.x_m) || !all_finite(ends.y_m) || !all_finite(ends.z_m)) {
    throw std::invalid_argument("ends of beams must be finite");
  }
  const bool qualities = std::all_of(ends.quality.begin(), ends.quality.end(),
                                     [](double q) { return q >= 0.0 && q <= 1.0; });
  if (!qualities) throw std::invalid_argument("the quality of beams must lie in 0 ... 1");
}

void field_log_likelihoods(const LikelihoodField& field, const Endpoints& ends,
                           BeamAggregation aggregation, double kappa, const Particles& particles,
                           std::size_t first, std::size_t last, double* out) {
  if (!field.is_flat() && ends.z_m.empty() && ends.beams() > 0) {
    throw std::invalid_argument("a field with layers needs the heights of the ends of beams");
  }
  const GridTransform to_grid = grid_transform_of(field.frame());
  const Task task = task_of(field, ends, to_grid);
  BlockPoses poses;
  double logs[kBlock];
  for (std::size_t start = first; start < last; start += kBlock) {
    const std::size_t count = std::min(kBlock, last - start);
    pose_block(&particles.x[start], &particles.y[start], &particles.yaw[start], count, to_grid,
               poses);
    if (aggregation == BeamAggregation::kCubeSum) {
      cube_sums(poses, task, logs);
    } else {
      products(poses, task, kappa, logs);
    }
    std::copy(logs, logs + count, out + start);
  }
}

}  // namespace mapperd::localization
