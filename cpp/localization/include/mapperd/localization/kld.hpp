/// \file
/// \brief KLD-sampling (Fox 2001): number of particles from the number of occupied buckets of
/// space.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

/// `quantile` is the standard normal quantile itself, not a probability.
struct KldParams {
  double error = 0.05;
  double quantile = 0.99;
  double bucket_x_m = 0.5;
  double bucket_y_m = 0.5;
  double bucket_yaw_rad = 0.17453292519943295;
};

/// \throws std::invalid_argument for error 0, a negative quantile or buckets of no size.
void check_kld(const KldParams& rule);

/// n(k) = ceil((k - 1) / (2 error) (1 - 2 / (9 (k - 1)) + quantile sqrt(2 / (9 (k - 1))))^3), the
/// Wilson-Hilferty form of the chi-square quantile. Up to two buckets give no information: the
/// result is then the largest number, as in the reference implementation.
std::size_t kld_size(std::size_t buckets, double error, double quantile);

/// Returns a pose's bucket: 25 bits of x and of y, 14 of yaw. Poses beyond 2^24 buckets from the
/// origin share the outermost ones.
std::uint64_t bucket_of(const Pose2& pose, double x_m, double y_m, double yaw_rad);

/// A set of buckets.
class BucketSet {
 public:
  explicit BucketSet(std::size_t most);
  /// Returns whether the bucket is new.
  bool insert(std::uint64_t bucket);
  std::size_t size() const { return size_; }

 private:
  std::vector<std::uint64_t> slot_;
  std::uint64_t mask_;
  std::size_t size_ = 0;
};

}  // namespace mapperd::localization
