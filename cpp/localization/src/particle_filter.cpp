#include "mapperd/localization/particle_filter.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/parallel.hpp"
#include "mapperd/localization/gaussian.hpp"

namespace mapperd::localization {
namespace {

constexpr std::size_t kParticlesATask = 8 * kBlock;
constexpr std::size_t kMaxParticles = 10'000'000;

// Mean likelihood of a beam: neither particles nor beams in numbers change it, nor kappa.
double fit_of(double log_evidence, std::size_t beams, FitKind kind, double kappa) {
  const double count = static_cast<double>(beams);
  switch (kind) {
    case FitKind::kCubeSumFromOne:
      return std::expm1(log_evidence) / count;
    case FitKind::kCubeSum:
      return std::exp(log_evidence) / count;
    case FitKind::kProduct:
      break;
  }
  return std::exp(log_evidence / (kappa * count));
}

void check_kappa(double kappa) {
  if (!(kappa > 0.0 && kappa <= 1.0)) {
    throw std::invalid_argument("the tempering exponent must lie above 0 and up to 1");
  }
}

// Result for a scan without information.
bool sum_to_one(Particles& particles) {
  return reweight(particles.log_weight, std::vector<double>(particles.size())).informative;
}

}  // namespace

void check_filter_rule(const FilterParams& rule) {
  const ResampleParams& r = rule.resample;
  if (r.min_particles < 1 || r.min_particles > r.max_particles || r.max_particles > kMaxParticles) {
    throw std::invalid_argument("particles must be 1 <= min <= max <= 10000000");
  }
  check_kld(r.kld);
  static_cast<void>(Recovery(rule.alpha_slow, rule.alpha_fast));
  if (rule.resample_interval < 1) {
    throw std::invalid_argument("resample_interval must be at least 1");
  }
  if (!(rule.max_step_m > 0.0)) throw std::invalid_argument("max_step_m must be above 0");
  if (!(rule.least_effective_share >= 0.0 && rule.least_effective_share < 1.0)) {
    throw std::invalid_argument("the share of the effective size must lie in 0 ... 1, without 1");
  }
  if (!(rule.draw_exponent > 0.0 && rule.draw_exponent <= 1.0)) {
    throw std::invalid_argument("the exponent of draws must lie above 0 and up to 1");
  }
}

ParticleFilter::ParticleFilter(const FilterParams& rule, std::uint64_t seed, int threads)
    : rule_(rule), seed_(seed), threads_(threads), recovery_(rule.alpha_slow, rule.alpha_fast) {
  check_filter_rule(rule);
}

void ParticleFilter::set_rule(const FilterParams& rule) {
  check_filter_rule(rule);
  const bool same = rule.alpha_slow == rule_.alpha_slow && rule.alpha_fast == rule_.alpha_fast;
  if (!same) recovery_ = Recovery(rule.alpha_slow, rule.alpha_fast);
  rule_ = rule;
}

void ParticleFilter::set_threads(int threads) { threads_ = threads; }

template <typename Task>
void ParticleFilter::in_blocks(const Task& task) const {
  const std::size_t count = particles_.size();
  run_parallel((count + kParticlesATask - 1) / kParticlesATask, threads_, [&](std::size_t k) {
    task(k * kParticlesATask, std::min(count, (k + 1) * kParticlesATask));
  });
}

void ParticleFilter::begin() {
  recovery_.reset();
  updates_since_start_ = 0;
}

void ParticleFilter::start_about(const Pose2& mean, const Matrix3& covariance) {
  if (!is_finite(mean)) throw std::invalid_argument("the pose must be finite");
  const Matrix3 root = square_root_of(covariance);
  particles_.resize(rule_.resample.max_particles);
  draw_about(mean, root, next_stream(), particles_);
  begin();
}

void ParticleFilter::start_anywhere(const FreeSpace& free) {
  particles_.resize(rule_.resample.max_particles);
  const Stream stream = next_stream();
  for (std::size_t i = 0; i < particles_.size(); ++i) {
    particles_.set(i, free.draw_pose(stream, Purpose::kStart, static_cast<std::uint32_t>(i)));
  }
  begin();
}

void ParticleFilter::start_with(Particles particles) {
  // Twice as many: two clouds of the greatest size are judged together.
  if (particles.size() > 2 * kMaxParticles) throw std::invalid_argument("too many particles");
  for (std::size_t i = 0; i < particles.size(); ++i) {
    if (!is_finite(particles.pose(i))) throw std::invalid_argument("particles must be finite");
    particles.yaw[i] = wrapped(particles.yaw[i]);
  }
  if (particles.size() > 0 && !sum_to_one(particles)) {
    throw std::invalid_argument("some particle must have weight");
  }
  particles_ = std::move(particles);
  begin();
}

FilterState ParticleFilter::state() const {
  return {particles_, seed_, step_, updates_since_start_, recovery_.averages(), counts_};
}

void ParticleFilter::restore(FilterState state) {
  const Particles& cloud = state.particles;
  if (cloud.size() > kMaxParticles) throw std::invalid_argument("too many particles");
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    // A weight may be 0; its logarithm is then -infinity.
    if (!is_finite(cloud.pose(i)) || !(cloud.log_weight[i] <= 1e-6)) {
      throw std::invalid_argument("particles must be finite, and weights at most 1");
    }
  }
  if (!std::isfinite(state.averages.slow) || !std::isfinite(state.averages.fast)) {
    throw std::invalid_argument("averages must be finite");
  }
  particles_ = std::move(state.particles);
  seed_ = state.seed;
  step_ = state.step;
  updates_since_start_ = state.updates_since_start;
  recovery_.set_averages(state.averages);
  counts_ = state.counts;
}

void ParticleFilter::start_by_scan(const FreeSpace& free, const LikelihoodField& field,
                                   const Endpoints& ends, const Search& search) {
  check_endpoints(ends);
  check_kappa(search.kappa);
  particles_ = drawn_by_scan(free, field, ends, search, rule_.resample.max_particles, next_stream(),
                             threads_);
  begin();
}

bool ParticleFilter::predict(const Pose2& before, const Pose2& now, MotionModel model,
                             const Alphas& alphas, const MotionFloor& floor) {
  for (const double alpha : alphas) {
    if (!(alpha >= 0.0 && alpha <= 1e6)) throw std::invalid_argument("alphas must not be negative");
  }
  const auto is_noise = [](double sigma) { return sigma >= 0.0 && sigma <= 1e6; };
  if (!is_noise(floor.sigma_xy_m) || !is_noise(floor.sigma_yaw_rad)) {
    throw std::invalid_argument("floors of motion noise must lie in 0 ... 1e6");
  }
  const bool possible = is_finite(before) && is_finite(now) &&
                        std::hypot(now.x - before.x, now.y - before.y) <= rule_.max_step_m;
  if (!possible) {
    ++counts_.refused_steps;
    return false;
  }
  const MotionDraws draws = motion_draws(model, before, now, alphas);
  const Stream stream = next_stream();
  in_blocks([&](std::size_t first, std::size_t last) {
    move(particles_, first, last, draws, floor, stream);
  });
  return true;
}

Weighed ParticleFilter::weigh(const LikelihoodField& field, const Endpoints& ends,
                              BeamAggregation aggregation, double kappa) {
  check_endpoints(ends);
  check_kappa(kappa);
  std::vector<double> logs(particles_.size());
  in_blocks([&](std::size_t first, std::size_t last) {
    field_log_likelihoods(field, ends, aggregation, kappa, particles_, first, last, logs.data());
  });
  const bool product = aggregation == BeamAggregation::kProduct;
  return weigh(logs, ends.beams(), product ? FitKind::kProduct : FitKind::kCubeSumFromOne, kappa);
}

Weighed ParticleFilter::weigh(const RangeMap& map, const Beams& beams, const BeamModel& model,
                              BeamAggregation aggregation, double kappa) {
  check_beams(beams);
  check_beam_model(model);
  check_kappa(kappa);
  std::vector<double> logs(particles_.size());
  in_blocks([&](std::size_t first, std::size_t last) {
    beam_log_likelihoods(map, beams, model, aggregation, kappa, particles_, first, last,
                         logs.data());
  });
  const bool product = aggregation == BeamAggregation::kProduct;
  return weigh(logs, beams.size(), product ? FitKind::kProduct : FitKind::kCubeSum, kappa);
}

Weighed ParticleFilter::weigh(const std::vector<double>& log_likelihood, std::size_t beams,
                              FitKind kind, double kappa) {
  check_kappa(kappa);
  if (log_likelihood.size() != particles_.size()) {
    throw std::invalid_argument("each particle needs a likelihood");
  }
  ++counts_.updates;
  ++updates_since_start_;
  if (beams == 0 || particles_.size() == 0) {
    ++counts_.empty_scans;
    return {false, 0.0, 0.0, recovery_.injected_share(), 1.0};
  }
  const std::vector<double> before = particles_.log_weight;
  const Reweighted done = reweight(particles_.log_weight, log_likelihood);
  counts_.not_a_number += done.not_a_number;
  if (!done.informative) {
    ++counts_.uninformative_scans;
    return {false, 0.0, 0.0, recovery_.injected_share(), 1.0};
  }
  const double fit = fit_of(done.log_evidence, beams, kind, kappa);
  recovery_.add(fit);
  const double share = rule_.least_effective_share;
  const double exponent = share > 0.0 ? bearable_exponent(before, log_likelihood, share) : 1.0;
  if (exponent < 1.0) {
    std::vector<double> raised = log_likelihood;
    for (double& value : raised) value *= exponent;
    particles_.log_weight = before;
    reweight(particles_.log_weight, raised);
  }
  return {true, done.log_evidence, fit, recovery_.injected_share(), exponent};
}

bool ParticleFilter::resample_if_due(const FreeSpace* free) {
  if (updates_since_start_ == 0 || updates_since_start_ % rule_.resample_interval != 0)
    return false;
  const double half = 0.5 * static_cast<double>(particles_.size());
  if (rule_.selective && !(effective_size() < half)) return false;
  resample(free);
  return true;
}

void ParticleFilter::resample(const FreeSpace* free) {
  if (particles_.size() == 0) return;
  const double kept = 1.0 - rule_.draw_exponent;
  const std::vector<double> weight = draw_weights();
  const double share = free == nullptr ? 0.0 : recovery_.injected_share();
  const bool adaptive = rule_.resample.min_particles < rule_.resample.max_particles;
  const bool converged = adaptive && fits_one_bucket(estimate());
  const Stream stream = next_stream();
  const Drawn drawn =
      draw_parents(particles_, weight, rule_.resample, converged, share, free, stream);
  const double kept_by_random = log_of_mean_kept(weight);
  Particles next;
  next.resize(drawn.parent.size());
  for (std::size_t i = 0; i < drawn.parent.size(); ++i) {
    const std::size_t parent = drawn.parent[i];
    if (parent != kRandom) {
      next.set(i, particles_.pose(parent));
      next.log_weight[i] += kept * particles_.log_weight[parent];
      continue;
    }
    ++counts_.injected_particles;
    next.log_weight[i] += kept_by_random;
    next.set(i, free->draw_pose(stream, Purpose::kInjection, static_cast<std::uint32_t>(i)));
  }
  if (kept > 0.0) sum_to_one(next);
  particles_ = std::move(next);
  ++counts_.resamplings;
  if (share > 0.0) recovery_.reset();
}

std::vector<double> ParticleFilter::draw_weights() const {
  if (rule_.draw_exponent == 1.0) return weights();
  std::vector<double> powers = particles_.log_weight;
  const double largest = *std::max_element(powers.begin(), powers.end());
  for (double& power : powers) power = rule_.draw_exponent * (power - largest);
  return linear_weights(powers);
}

// Children keep w^(1 - a) of parents drawn by w^a: 1 / sum of w^a in the mean. Random particles are
// to weigh as much as children do, else a few of them outweigh the cloud.
double ParticleFilter::log_of_mean_kept(const std::vector<double>& draw_weight) const {
  if (rule_.draw_exponent == 1.0) return 0.0;
  const std::vector<double>& logs = particles_.log_weight;
  const double largest = *std::max_element(logs.begin(), logs.end());
  const double sum = std::accumulate(draw_weight.begin(), draw_weight.end(), 0.0);
  return -std::log(sum) - rule_.draw_exponent * largest;
}

bool ParticleFilter::fits_one_bucket(const Estimate& estimate) const {
  const KldParams& kld = rule_.resample.kld;
  return estimate.heading_known && std::sqrt(estimate.covariance[0][0]) < kld.bucket_x_m &&
         std::sqrt(estimate.covariance[1][1]) < kld.bucket_y_m &&
         std::sqrt(estimate.covariance[2][2]) < kld.bucket_yaw_rad;
}

double ParticleFilter::effective_size() const { return localization::effective_size(weights()); }

Estimate ParticleFilter::estimate() const { return estimate_of(particles_, weights()); }

Clusters ParticleFilter::clusters(const ClusterParams& rule) const {
  return clusters_of(particles_, weights(), rule);
}

}  // namespace mapperd::localization
