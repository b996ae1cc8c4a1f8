// How many particles a belief needs (Fox 2001), by the buckets of space that it occupies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

// `quantile` is the standard normal quantile itself, not a probability.
struct KldRule {
  double error = 0.05;
  double quantile = 0.99;
  double bucket_x_m = 0.5;
  double bucket_y_m = 0.5;
  double bucket_yaw_rad = 0.17453292519943295;
};

// Throws std::invalid_argument: error 0, a negative quantile, buckets of no size.
void check_kld(const KldRule& rule);

// n(k) = ceil((k - 1) / (2 error) (1 - 2 / (9 (k - 1)) + quantile sqrt(2 / (9 (k - 1))))^3), the
// Wilson-Hilferty form of the chi-square quantile. Up to two buckets say nothing: the largest
// number of all, as in the reference.
std::size_t kld_size(std::size_t buckets, double error, double quantile);

// A pose's bucket: 25 bits of x and of y, 14 of yaw, exactly; places beyond 2^24 buckets from the
// origin share the outermost.
std::uint64_t bucket_of(const Pose2& pose, double x_m, double y_m, double yaw_rad);

// A set of buckets.
class BucketSet {
 public:
  explicit BucketSet(std::size_t most);
  // Whether it is new.
  bool insert(std::uint64_t bucket);
  std::size_t size() const { return size_; }

 private:
  std::vector<std::uint64_t> slot_;
  std::uint64_t mask_;
  std::size_t size_ = 0;
};

}  // namespace mapperd::localization
