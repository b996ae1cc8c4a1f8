#include "mapperd/localization/resample.hpp"

#include <algorithm>
#include <cmath>

namespace mapperd::localization {
namespace {

// Finds the parent of a place in the sum of weights, by a table of where to begin.
class Wheel {
 public:
  explicit Wheel(const std::vector<double>& weight) : until_(weight.size()), begin_(weight.size()) {
    double sum = 0.0;
    for (std::size_t i = 0; i < weight.size(); ++i) {
      sum += weight[i];
      until_[i] = sum;
      if (weight[i] > 0.0) last_ = i;
    }
    per_unit_ = static_cast<double>(weight.size()) / sum;
    std::size_t at = 0;
    for (std::size_t k = 0; k < begin_.size(); ++k) {
      while (at < last_ && until_[at] * per_unit_ < static_cast<double>(k)) ++at;
      begin_[k] = at;
    }
    sum_ = sum;
  }

  std::size_t parent(double uniform) const {
    const double place = uniform * sum_;
    const auto k = static_cast<std::size_t>(place * per_unit_);
    // Rounding keeps the order of products: the beginning is never behind the parent.
    std::size_t at = begin_[std::min(k, begin_.size() - 1)];
    while (at < last_ && until_[at] <= place) ++at;
    return at;
  }

 private:
  std::vector<double> until_;
  std::vector<std::size_t> begin_;
  double per_unit_ = 0.0;
  double sum_ = 0.0;
  std::size_t last_ = 0;  // of those with weight
};

// The draws of one resampling, each with its own key.
class Draws {
 public:
  Draws(const Particles& particles, const std::vector<double>& weight, double random_share,
        const FreeSpace* free, const Stream& stream)
      : particles_(particles),
        wheel_(weight),
        random_share_(random_share),
        free_(free),
        stream_(stream) {}

  std::size_t parent(std::size_t i) const {
    const Words words = draw(stream_, Purpose::kResampling, static_cast<std::uint32_t>(i));
    const bool random = i > 0 && free_ != nullptr && uniform_of(words.word[0]) < random_share_;
    return random ? kRandom : wheel_.parent(uniform_of(words.word[1], words.word[2]));
  }

  Pose2 pose(std::size_t i, std::size_t parent) const {
    if (parent != kRandom) return particles_.pose(parent);
    return free_->draw_pose(stream_, Purpose::kInjection, static_cast<std::uint32_t>(i));
  }

  double offset() const {
    const Words words = draw(stream_, Purpose::kResampling, 0xFFFFFFFFU);
    return uniform_of(words.word[1], words.word[2]);
  }

 private:
  const Particles& particles_;
  Wheel wheel_;
  double random_share_;
  const FreeSpace* free_;
  Stream stream_;
};

Drawn independent(const Draws& draws, const ResampleParams& rule, bool converged) {
  Drawn drawn;
  const bool fixed = rule.min_particles == rule.max_particles;
  BucketSet buckets(fixed ? 1 : rule.max_particles);
  std::size_t wanted = rule.max_particles;
  for (std::size_t i = 0; i < wanted; ++i) {
    const std::size_t parent = draws.parent(i);
    drawn.parent.push_back(parent);
    if (fixed) continue;
    const KldParams& kld = rule.kld;
    const std::uint64_t bucket =
        bucket_of(draws.pose(i, parent), kld.bucket_x_m, kld.bucket_y_m, kld.bucket_yaw_rad);
    if (!buckets.insert(bucket)) continue;
    const bool one_place = converged && buckets.size() <= 2;
    const std::size_t size = one_place ? 0 : kld_size(buckets.size(), kld.error, kld.quantile);
    wanted = std::clamp(size, rule.min_particles, rule.max_particles);
  }
  drawn.buckets = buckets.size();
  return drawn;
}

// Leaves random draws where they are and combs the rest.
void comb_parents(Drawn& drawn, const std::vector<double>& weight, double offset) {
  const auto kept =
      static_cast<std::size_t>(std::count_if(drawn.parent.begin(), drawn.parent.end(),
                                             [](std::size_t parent) { return parent != kRandom; }));
  const std::vector<std::size_t> combed = comb(weight, kept, offset);
  std::size_t next = 0;
  for (std::size_t& parent : drawn.parent) {
    if (parent != kRandom) parent = combed[next++];
  }
}

}  // namespace

std::vector<std::size_t> comb(const std::vector<double>& weight, std::size_t count, double offset) {
  double sum = 0.0;
  std::size_t last = 0;
  for (std::size_t i = 0; i < weight.size(); ++i) {
    sum += weight[i];
    if (weight[i] > 0.0) last = i;
  }
  std::vector<std::size_t> parents(count);
  const double tooth = sum / static_cast<double>(count);
  double until = weight[0];
  std::size_t at = 0;
  for (std::size_t k = 0; k < count; ++k) {
    const double place = (static_cast<double>(k) + offset) * tooth;
    while (at < last && until <= place) until += weight[++at];
    parents[k] = at;
  }
  return parents;
}

Drawn draw_parents(const Particles& particles, const std::vector<double>& weight,
                   const ResampleParams& rule, bool converged, double random_share,
                   const FreeSpace* free, const Stream& stream) {
  const bool fixed = rule.min_particles == rule.max_particles;
  const bool combed = rule.scheme == Scheme::kLowVariance;
  const Draws draws(particles, weight, random_share, free, stream);
  if (fixed && combed && !(random_share > 0.0)) {
    return {comb(weight, rule.max_particles, draws.offset()), 0};
  }
  Drawn drawn = independent(draws, rule, converged);
  if (combed) comb_parents(drawn, weight, draws.offset());
  return drawn;
}

}  // namespace mapperd::localization
