#include "mapperd/projective.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>

#include "mapperd/voxel_integral.hpp"

namespace mapperd {
namespace {

// The walk from large cubes of space down to voxels, in coordinates local to the sonar's block:
// far from the map's origin no precision is lost.
class Walk {
 public:
  Walk(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
       const FanSettings& settings)
      : map_(map),
        fan_(image, settings, map.rule(), map_T_sonar),
        aggregation_(settings.aggregation),
        edge_m_(map.resolution_m()),
        block_m_(map.resolution_m() * kBlockEdge),
        revision_(map.next_revision()) {
    const auto split = [this](double position, std::int32_t& block, double& offset) {
      block = static_cast<std::int32_t>(std::floor(position / block_m_));
      offset = position - static_cast<double>(block) * block_m_;
    };
    split(map_T_sonar.translation.x, origin_.x, offset_.x);
    split(map_T_sonar.translation.y, origin_.y, offset_.y);
    split(map_T_sonar.translation.z, origin_.z, offset_.z);
  }

  PingStats run() {
    int span = kBlockEdge;
    while (span * edge_m_ < fan_.max_range_m() + block_m_) span *= 2;
    for (int octant = 0; octant < 8; ++octant) {
      visit((octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1, span);
    }
    return stats_;
  }

 private:
  // A cube of `span` voxels along an edge, at (x, y, z) in units of its own edge.
  void visit(int x, int y, int z, int span) {
    const double cube_m = span * edge_m_;
    const Vec3 centre = Vec3{(x + 0.5) * cube_m, (y + 0.5) * cube_m, (z + 0.5) * cube_m} - offset_;
    const Fan::Verdict verdict = fan_.verdict(centre, cube_m);
    // A large cube that is less than half free may hold free voxels; a voxel is one.
    const bool settled = verdict.content == Fan::Content::nothing ||
                         (span == 1 && verdict.content == Fan::Content::less_free);
    if (settled) return;
    if (span == 1) return visit_voxel(centre, verdict, offset_in_block(x, y, z));
    if (span == kBlockEdge) return visit_block({x, y, z}, verdict.content);
    if (span < kBlockEdge && verdict.content == Fan::Content::all_free) {
      return free_part_of_block(x * span, y * span, z * span, span);
    }
    visit_children(x, y, z, span);
  }

  void visit_children(int x, int y, int z, int span) {
    for (int child = 0; child < 8; ++child) {
      visit(2 * x + (child & 1), 2 * y + (child >> 1 & 1), 2 * z + (child >> 2 & 1), span / 2);
    }
  }

  void visit_block(const BlockKey& local, Fan::Content content) {
    ++stats_.blocks_visited;
    block_ = nullptr;
    voxels_ = nullptr;
    local_ = local;
    if (content == Fan::Content::all_free) {
      if (block().add_free_everywhere(map_.rule())) block().revision = revision_;
      stats_.free += kBlockVoxels;
      return;
    }
    visit_children(local.x, local.y, local.z, kBlockEdge);
    if (voxels_ == nullptr) return;
    block().close(map_.rule());
    block().revision = revision_;
  }

  static int offset_in_block(int x, int y, int z) {
    const int mask = kBlockEdge - 1;
    return voxel_offset(x & mask, y & mask, z & mask);
  }

  void free_part_of_block(int x0, int y0, int z0, int span) {
    for (int z = z0; z < z0 + span; ++z) {
      for (int y = y0; y < y0 + span; ++y) {
        for (int x = x0; x < x0 + span; ++x) apply_free(offset_in_block(x, y, z));
      }
    }
  }

  void visit_voxel(const Vec3& centre, const Fan::Verdict& verdict, int offset) {
    if (verdict.content != Fan::Content::undecided) return apply_free(offset);
    const Cube cube{{centre.x, centre.y, centre.z}, edge_m_ / 2};
    const Two occupied = occupied_part(fan_, cube, verdict.where);
    if (occupied.part >= kOccupiedPart) {
      const double weight = std::clamp(occupied.weight / occupied.part, 0.0, 1.0);
      if (aggregation_ == Aggregation::occupied_first) return apply_occupied(weight, offset);
      return apply_mean(occupied.part, weight, free_part(fan_, cube, verdict.where), offset);
    }
    if (free_part(fan_, cube, verdict.where) > kFreePart) apply_free(offset);
  }

  void apply_occupied(double weight, int offset) {
    const auto i = static_cast<std::size_t>(offset);
    std::int32_t& units = voxels().units[i];
    std::uint16_t& count = voxels().count[i];
    map_.rule().add(map_.rule().occupied_step(log_odds_of(units), count, weight), units, count);
    ++stats_.occupied;
  }

  void apply_mean(double occupied, double weight, double free, int offset) {
    const auto i = static_cast<std::size_t>(offset);
    std::int32_t& units = voxels().units[i];
    std::uint16_t& count = voxels().count[i];
    const double up = map_.rule().occupied_step(log_odds_of(units), count, weight);
    const double down = map_.rule().free_step(log_odds_of(units), count);
    map_.rule().add((occupied * up + free * down) / (occupied + free), units, count);
    ++stats_.occupied;
  }

  void apply_free(int offset) {
    const auto i = static_cast<std::size_t>(offset);
    map_.rule().add_free(voxels().units[i], voxels().count[i]);
    ++stats_.free;
  }

  // The block is made, and opened, at its first evidence: looking at nothing creates nothing.
  Block& block() {
    if (block_ == nullptr) {
      const std::size_t before = map_.block_count();
      block_ =
          &map_.get_or_create({origin_.x + local_.x, origin_.y + local_.y, origin_.z + local_.z});
      stats_.blocks_created += map_.block_count() - before;
    }
    return *block_;
  }

  DenseVoxels& voxels() {
    if (voxels_ == nullptr) voxels_ = &block().open(map_.rule());
    return *voxels_;
  }

  VoxelMap& map_;
  Fan fan_;
  Aggregation aggregation_;
  double edge_m_;
  double block_m_;
  BlockKey origin_;  // the sonar's block
  Vec3 offset_;      // the sonar inside it
  BlockKey local_;   // the block at hand, relative to origin_
  Block* block_ = nullptr;
  DenseVoxels* voxels_ = nullptr;
  std::uint64_t revision_;
  PingStats stats_;
};

}  // namespace

void check_reach(const VoxelMap& map, const Transform& map_T_sonar, double max_range_m) {
  const double block_m = map.resolution_m() * kBlockEdge;
  const Vec3& at = map_T_sonar.translation;
  for (const double position : {at.x, at.y, at.z}) {
    if (!std::isfinite(position)) throw std::invalid_argument("map_T_sonar is not finite");
    if ((std::abs(position) + max_range_m) / block_m + 2 > kMaxBlock) {
      throw std::out_of_range("the ping lies beyond the map's reach");
    }
  }
  for (const Vec3& row : map_T_sonar.rows) {
    if (!(std::abs(norm(row) - 1.0) < 1e-6)) {
      throw std::invalid_argument("map_T_sonar is no rigid transform");
    }
  }
}

PingStats integrate_projective(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
                               const FanSettings& settings) {
  check_ping(image, settings);
  check_reach(map, map_T_sonar, image.max_range_m());
  const WriteLock lock(map);
  return Walk(map, image, map_T_sonar, settings).run();
}

}  // namespace mapperd
