#include "mapperd/map/rays.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include "mapperd/common/progress.hpp"
#include "mapperd/map/block_writer.hpp"

namespace mapperd::map {
namespace {

constexpr std::size_t kUsedBeams = 256;
constexpr std::size_t kFreeRowStep = 10;
constexpr std::size_t kReturnRows = 50;
constexpr double kFreeVoxelStep = 4.0;
constexpr double kReturnVoxelStep = 1.5;
constexpr std::size_t kSamplesAPart = 65536;  // of progress

struct FirstHit {
  double bearing_rad;
  double range_m;
};

struct VoxelIndexHash {
  std::size_t operator()(const VoxelIndex& v) const {
    auto h = static_cast<std::uint64_t>(v.x) * 0x9E3779B97F4A7C15ULL;
    h = (h ^ (h >> 32U) ^ static_cast<std::uint64_t>(v.y)) * 0xC2B2AE3D27D4EB4FULL;
    h = (h ^ (h >> 29U) ^ static_cast<std::uint64_t>(v.z)) * 0x165667B19E3779F9ULL;
    return h ^ (h >> 32U);
  }
};

struct Sample {
  VoxelIndex voxel;
  bool occupied;
  float intensity;
};

class RaySampler {
 public:
  RaySampler(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
             const RaysParams& settings, const PingMotion& motion)
      : map_(map),
        image_(image),
        settings_(settings),
        stride_(std::max<std::size_t>(1, image.beams / kUsedBeams)) {
    const double fov = image.bearings_rad[image.beams - 1] - image.bearings_rad[0];
    shadow_tolerance_ = fov / static_cast<double>(image.beams) * settings.angular_cone_width * 2.0;
    const BlockPose start = at_transmission(map_T_sonar, motion, map.resolution_m() * kBlockEdge);
    block_T_sonar_ = start.block_T_sonar;
    const auto first_voxel = [](std::int32_t block) { return std::int64_t{block} * kBlockEdge; };
    origin_ = {first_voxel(start.block.x), first_voxel(start.block.y), first_voxel(start.block.z)};
    if (motion.any()) view_.emplace(motion, block_T_sonar_);
  }

  PingStats run() {
    collect_first_hits();
    for (std::size_t j = 0; j < image_.beams; j += stride_) {
      const std::size_t hit = first_hit_row(j);
      if (hit == image_.rows) continue;  // a beam without a return has no information
      sample_free(j, hit);
      sample_returns(j, hit);
      finish_part();
    }
    fetch();
    return update_map();
  }

 private:
  double range_of(std::size_t row) const {
    return static_cast<double>(row) * image_.range_resolution_m;
  }

  std::size_t first_hit_row(std::size_t j) const {
    for (std::size_t k = 0; k < image_.rows; ++k) {
      if (map_.rule().is_return(image_.at(k, j)) && range_of(k) >= settings_.min_range_m) return k;
    }
    return image_.rows;
  }

  void collect_first_hits() {
    for (std::size_t j = 0; j < image_.beams; j += stride_) {
      const std::size_t hit = first_hit_row(j);
      if (hit < image_.rows) first_hits_.push_back({image_.bearings_rad[j], range_of(hit)});
    }
  }

  template <typename Visit>
  void for_elevations(double range, double voxel_step, const Visit& visit) const {
    const double half = settings_.vertical_aperture_rad / 2;
    const double steps = range * std::tan(half) / (voxel_step * map_.resolution_m());
    const int n = std::max(1, static_cast<int>(steps));
    for (int k = -n; k <= n; ++k) visit(static_cast<double>(k) / n * half);
  }

  // From where the sonar was at transmission, in the map's axes.
  Vec3 placed(double range, double bearing, double elevation) const {
    const Vec3 seen = block_T_sonar_.rotate(fan_point(range, bearing, elevation));
    return view_ ? view_->place_of(seen) : seen;
  }

  void sample_free(std::size_t j, std::size_t hit) {
    const double bearing = image_.bearings_rad[j];
    for (std::size_t k = 0; k < hit; k += kFreeRowStep) {
      const double range = range_of(k);
      for_elevations(range, kFreeVoxelStep, [&](double elevation) {
        const Vec3 offset = placed(range, bearing, elevation);
        if (!in_shadow(bearing, std::hypot(offset.x, offset.y))) {
          merge(offset + block_T_sonar_.translation, false, 0.0F);
        }
      });
    }
  }

  void sample_returns(std::size_t j, std::size_t hit) {
    const std::size_t end = std::min(image_.rows, hit + kReturnRows);
    for (std::size_t k = hit; k < end; ++k) {
      if (!map_.rule().is_return(image_.at(k, j))) continue;
      const double range = range_of(k);
      for_elevations(range, kReturnVoxelStep, [&](double elevation) {
        const Vec3 offset = placed(range, image_.bearings_rad[j], elevation);
        merge(offset + block_T_sonar_.translation, true, image_.at(k, j));
      });
    }
  }

  bool in_shadow(double bearing, double horizontal_m) const {
    const auto from =
        std::upper_bound(first_hits_.begin(), first_hits_.end(), bearing - shadow_tolerance_,
                         [](double b, const FirstHit& hit) { return b < hit.bearing_rad; });
    for (auto hit = from; hit != first_hits_.end(); ++hit) {
      if (hit->bearing_rad >= bearing + shadow_tolerance_) return false;
      if (hit->bearing_rad != bearing && hit->range_m > 0 && horizontal_m > hit->range_m) {
        return true;
      }
    }
    return false;
  }

  void merge(const Vec3& point, bool occupied, float intensity) {
    const auto index = [this](double v) {
      return static_cast<std::int64_t>(std::floor(v / map_.resolution_m()));
    };
    const VoxelIndex voxel{origin_.x + index(point.x), origin_.y + index(point.y),
                           origin_.z + index(point.z)};
    if (!map_.limit().holds(block_holding(voxel))) return;
    const auto [found, is_new] = order_.try_emplace(voxel, samples_.size());
    if (is_new) {
      samples_.push_back({voxel, occupied, intensity});
    } else if (occupied && !samples_[found->second].occupied) {
      samples_[found->second] = {voxel, true, intensity};
    }
  }

  void fetch() const {
    if (!map_.residency().is_partial()) return;
    std::vector<BlockKey> blocks;
    blocks.reserve(samples_.size());
    for (const Sample& sample : samples_) blocks.push_back(block_holding(sample.voxel));
    map_.residency().fetch(blocks);
  }

  PingStats update_map() {
    PingStats stats;
    const WriteLock lock(map_);
    const std::size_t before = map_.block_count();
    CellPool::Cache pool(map_.pool());
    std::unordered_map<Block*, CellSet> opened;
    const std::uint64_t revision = map_.next_revision();
    std::size_t done = 0;
    for (const Sample& sample : samples_) {
      if (++done % kSamplesAPart == 0) finish_part();
      const VoxelIndex& v = sample.voxel;
      const auto local = [](std::int64_t i) { return static_cast<int>(i & (kBlockEdge - 1)); };
      Block& at = map_.get_or_create(block_holding(v));
      const CellPlace place = cell_place(voxel_offset(local(v.x), local(v.y), local(v.z)));
      const CellVoxels cell = at.open(map_.rule(), pool, place.cell);
      opened[&at] |= cell_bit(place.cell);
      std::uint16_t count = cell.count(place.voxel);
      update(sample, cell.units()[place.voxel], count);
      cell.set_count(place.voxel, count);
      ++(sample.occupied ? stats.occupied : stats.free);
    }
    // NOLINTNEXTLINE(bugprone-nondeterministic-pointer-iteration-order): each block by itself
    for (auto& [block, cells] : opened) {
      for (CellSet left = cells; left != 0; left &= left - 1) {
        block->close(map_.rule(), pool, __builtin_ctzll(left));
      }
      block->revision = revision;
    }
    stats.blocks_created = map_.block_count() - before;
    return stats;
  }

  void update(const Sample& sample, std::int16_t& units, std::uint16_t& count) const {
    const IwloRule& rule = map_.rule();
    if (!sample.occupied) return rule.add_free(units, count);
    const std::int16_t full = rule.full_step(rule.occupied_weight(sample.intensity));
    rule.add(rule.occupied_units(units, count, full), units, count);
  }

  VoxelMap& map_;
  const PingImage& image_;
  Transform block_T_sonar_;  // at transmission, in the sonar's block
  std::optional<MovingView> view_;
  VoxelIndex origin_;  // that block's first voxel
  const RaysParams& settings_;
  std::size_t stride_;
  double shadow_tolerance_ = 0.0;
  std::vector<FirstHit> first_hits_;  // by bearing
  std::vector<Sample> samples_;       // in first-touch order
  std::unordered_map<VoxelIndex, std::size_t, VoxelIndexHash> order_;
};

}  // namespace

PingStats integrate_rays(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
                         const RaysParams& settings, const PingMotion& motion) {
  PingParams fan;
  fan.vertical_aperture_rad = settings.vertical_aperture_rad;
  fan.min_range_m = settings.min_range_m;
  check_ping(image, fan);
  check_reach(map, map_T_sonar, image.max_range_m(), motion);
  return RaySampler(map, image, map_T_sonar, settings, motion).run();
}

}  // namespace mapperd::map
