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
        block_m_(map.resolution_m() * kBlockEdge) {
    const auto split = [this](double position, std::int32_t& block, double& offset) {
      block = static_cast<std::int32_t>(std::floor(position / block_m_));
      offset = position - static_cast<double>(block) * block_m_;
    };
    split(map_T_sonar.translation.x, origin_.x, offset_.x);
    split(map_T_sonar.translation.y, origin_.y, offset_.y);
    split(map_T_sonar.translation.z, origin_.z, offset_.z);
  }

  PingStats run() {
    int level = 0;
    while ((1 << level) * block_m_ < fan_.max_range_m() + block_m_) ++level;
    const int span = 1 << level;
    for (int octant = 0; octant < 8; ++octant) {
      visit((octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1, level, span);
    }
    return stats_;
  }

 private:
  // A cube of `span` blocks along an edge, at (x, y, z) in units of its own edge.
  void visit(int x, int y, int z, int level, int span) {
    const double cube_m = span * block_m_;
    const Vec3 centre = Vec3{(x + 0.5) * cube_m, (y + 0.5) * cube_m, (z + 0.5) * cube_m} - offset_;
    const Fan::Content content = fan_.verdict(centre, cube_m).content;
    if (content == Fan::Content::nothing) return;  // less than half free may hold free voxels
    if (level == 0) {
      ++stats_.blocks_visited;
      visit_block({x, y, z}, content);
      return;
    }
    for (int child = 0; child < 8; ++child) {
      visit(2 * x + (child & 1), 2 * y + (child >> 1 & 1), 2 * z + (child >> 2 & 1), level - 1,
            span / 2);
    }
  }

  void visit_block(const BlockKey& local, Fan::Content content) {
    block_ = nullptr;
    local_ = local;
    for (int z = 0, offset = 0; z < kBlockEdge; ++z) {
      for (int y = 0; y < kBlockEdge; ++y) {
        for (int x = 0; x < kBlockEdge; ++x, ++offset) {
          if (content == Fan::Content::all_free) {
            apply_free(offset);
          } else {
            visit_voxel(x, y, z, offset);
          }
        }
      }
    }
  }

  void visit_voxel(int x, int y, int z, int offset) {
    const auto along = [this](std::int32_t block, int voxel, double sonar) {
      return block * block_m_ + (voxel + 0.5) * edge_m_ - sonar;
    };
    const Vec3 centre{along(local_.x, x, offset_.x), along(local_.y, y, offset_.y),
                      along(local_.z, z, offset_.z)};
    const Fan::Verdict verdict = fan_.verdict(centre, edge_m_);
    switch (verdict.content) {
      case Fan::Content::nothing:
      case Fan::Content::less_free:
        return;
      case Fan::Content::mostly_free:
      case Fan::Content::all_free:
        return apply_free(offset);
      case Fan::Content::undecided:
        return decide({{centre.x, centre.y, centre.z}, edge_m_ / 2}, verdict.where, offset);
    }
  }

  void decide(const Cube& cube, const FanPart& where, int offset) {
    const Two occupied = occupied_part(fan_, cube, where);
    if (occupied.part >= kOccupiedPart) {
      const double weight = std::clamp(occupied.weight / occupied.part, 0.0, 1.0);
      if (aggregation_ == Aggregation::occupied_first) return apply_occupied(weight, offset);
      return apply_mean(occupied.part, weight, free_part(fan_, cube, where), offset);
    }
    if (free_part(fan_, cube, where) > kFreePart) apply_free(offset);
  }

  void apply_occupied(double weight, int offset) {
    const VoxelState state = state_of(offset);
    add(map_.rule().occupied_step(state.log_odds, state.count, weight), offset);
    ++stats_.occupied;
  }

  void apply_mean(double occupied, double weight, double free, int offset) {
    const VoxelState state = state_of(offset);
    const double up = map_.rule().occupied_step(state.log_odds, state.count, weight);
    const double down = map_.rule().free_step(state.log_odds, state.count);
    add((occupied * up + free * down) / (occupied + free), offset);
    ++stats_.occupied;
  }

  void apply_free(int offset) {
    const VoxelState state = state_of(offset);
    add(map_.rule().free_step(state.log_odds, state.count), offset);
    ++stats_.free;
  }

  VoxelState state_of(int offset) {
    Block& block = opened_block();
    const auto i = static_cast<std::size_t>(offset);
    return {block.log_odds[i], block.count[i]};
  }

  void add(double step, int offset) {
    Block& block = opened_block();
    const auto i = static_cast<std::size_t>(offset);
    map_.rule().apply(step, block.log_odds[i], block.count[i]);
  }

  // The block is made at its first evidence, so that looking at nothing creates nothing.
  Block& opened_block() {
    if (block_ == nullptr) {
      const std::size_t before = map_.block_count();
      block_ =
          &map_.get_or_create({origin_.x + local_.x, origin_.y + local_.y, origin_.z + local_.z});
      stats_.blocks_created += map_.block_count() - before;
    }
    return *block_;
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
  return Walk(map, image, map_T_sonar, settings).run();
}

}  // namespace mapperd
