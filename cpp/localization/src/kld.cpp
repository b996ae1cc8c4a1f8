#include "mapperd/localization/kld.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {
namespace {

constexpr std::uint64_t kEmpty = ~std::uint64_t{0};

std::uint64_t cut_to_bits(double bucket, int bits) {
  const double reach = std::ldexp(1.0, bits - 1);
  const double kept = std::isnan(bucket) ? 0.0 : std::clamp(bucket, 1.0 - reach, reach - 1.0);
  return static_cast<std::uint64_t>(static_cast<std::int64_t>(kept) +
                                    (std::int64_t{1} << (bits - 1)));
}

}  // namespace

void check_kld(const KldParams& rule) {
  if (!(rule.error > 0.0 && rule.error <= 1.0)) {
    throw std::invalid_argument("the KLD error must lie above 0 and up to 1");
  }
  if (!(rule.quantile >= 0.0 && rule.quantile <= 40.0)) {
    throw std::invalid_argument("the KLD quantile must lie in 0 ... 40");
  }
  for (const double edge : {rule.bucket_x_m, rule.bucket_y_m, rule.bucket_yaw_rad}) {
    if (!(edge >= 1e-3) || !std::isfinite(edge)) {
      throw std::invalid_argument("the spatial resolution must be at least 0.001");
    }
  }
}

std::size_t kld_size(std::size_t buckets, double error, double quantile) {
  if (buckets <= 2) return std::numeric_limits<std::size_t>::max();
  const double others = static_cast<double>(buckets - 1);
  const double part = 2.0 / (9.0 * others);
  const double root = 1.0 - part + quantile * std::sqrt(part);
  const double wanted = std::ceil(others / (2.0 * error) * root * root * root);
  return wanted < 1e18 ? static_cast<std::size_t>(wanted) : std::numeric_limits<std::size_t>::max();
}

std::uint64_t bucket_of(const Pose2& pose, double x_m, double y_m, double yaw_rad) {
  return (cut_to_bits(std::floor(pose.x / x_m), 25) << 39) |
         (cut_to_bits(std::floor(pose.y / y_m), 25) << 14) |
         cut_to_bits(std::floor(wrapped(pose.yaw) / yaw_rad), 14);
}

BucketSet::BucketSet(std::size_t most) {
  std::size_t slots = 64;
  while (slots < 2 * most) slots *= 2;
  slot_.assign(slots, kEmpty);
  mask_ = slots - 1;
}

bool BucketSet::insert(std::uint64_t bucket) {
  std::uint64_t at = (bucket * 0x9E3779B97F4A7C15ULL) >> 20;
  while (slot_[at & mask_] != kEmpty) {
    if (slot_[at & mask_] == bucket) return false;
    ++at;
  }
  slot_[at & mask_] = bucket;
  ++size_;
  return true;
}

}  // namespace mapperd::localization
