#include "mapperd/map/projective.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "mapperd/map/block_evidence.hpp"
#include "mapperd/common/parallel.hpp"

namespace mapperd::map {
namespace {

// One ping: from large cubes of space down to blocks, then each block on its own. Coordinates are
// local to the sonar's block: far from the map's origin no precision is lost.
class PingUpdate {
 public:
  PingUpdate(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
             const FanSettings& settings, const PingMotion& motion)
      : map_(map),
        settings_(settings),
        block_m_(map.resolution_m() * kBlockEdge),
        start_(at_transmission(map_T_sonar, motion, block_m_)),
        fan_(image, settings, map.rule(), start_.block_T_sonar, motion) {}

  PingStats run() {
    find_blocks();
    look();
    fetch();
    apply();
    return stats_;
  }

 private:
  void find_blocks() {
    int span = 1;
    while (span * block_m_ < fan_.reach_m() + block_m_) span *= 2;
    for (int octant = 0; octant < 8; ++octant) {
      visit({(octant & 1) - 1, (octant >> 1 & 1) - 1, (octant >> 2 & 1) - 1}, span);
    }
    stats_.blocks_visited = free_.size() + crossed_.size();
  }

  // A cube of `span` blocks along an edge, at `at` in units of its own edge.
  void visit(const BlockKey& at, int span) {
    const BlockKey low = absolute({at.x * span, at.y * span, at.z * span});
    const int rest = span - 1;
    if (!map_.limit().meets(low, {low.x + rest, low.y + rest, low.z + rest})) return;
    const double cube_m = span * block_m_;
    const Vec3 centre = Vec3{(at.x + 0.5) * cube_m, (at.y + 0.5) * cube_m, (at.z + 0.5) * cube_m} -
                        start_.block_T_sonar.translation;
    const Fan::Content content = fan_.verdict(centre, cube_m).content;
    // A cube that is less than half free may hold free voxels.
    if (content == Fan::Content::nothing) return;
    if (span == 1) {
      return (content == Fan::Content::all_free ? free_ : crossed_).push_back(at);
    }
    for (int child = 0; child < 8; ++child) {
      visit({2 * at.x + (child & 1), 2 * at.y + (child >> 1 & 1), 2 * at.z + (child >> 2 & 1)},
            span / 2);
    }
  }

  void look() {
    evidence_.resize(crossed_.size());
    const BlockLooker looker(fan_, settings_, map_.rule(), map_.resolution_m(),
                             start_.block_T_sonar.translation);
    run_parallel(crossed_.size(), settings_.threads,
                 [&](std::size_t i) { looker.look(crossed_[i], evidence_[i]); });
  }

  // What is to be changed comes into memory before anything is: the ping counts wholly or not.
  void fetch() const {
    if (!map_.residency().is_partial()) return;
    std::vector<BlockKey> blocks;
    for (const BlockKey& at : free_) blocks.push_back(absolute(at));
    for (const BlockEvidence& evidence : evidence_) {
      if (!evidence.empty()) blocks.push_back(absolute(evidence.key));
    }
    map_.residency().fetch(blocks);
  }

  // Blocks are made at their first evidence, looking at nothing creates nothing; then each is
  // changed by one thread.
  void apply() {
    const WriteLock lock(map_);
    const std::size_t before = map_.block_count();
    const std::uint64_t revision = map_.next_revision();
    for (const BlockKey& at : free_) {
      Block& block = block_at(at);
      if (block.add_free_everywhere(map_.rule())) block.revision = revision;
      stats_.free += kBlockVoxels;
    }
    std::vector<Block*> blocks;
    for (const BlockEvidence& evidence : evidence_) {
      blocks.push_back(evidence.empty() ? nullptr : &block_at(evidence.key));
    }
    run_parallel(blocks.size(), settings_.threads, [&](std::size_t i) {
      if (blocks[i] != nullptr && change(*blocks[i], evidence_[i])) blocks[i]->revision = revision;
    });
    for (const BlockEvidence& evidence : evidence_) count(evidence);
    stats_.blocks_created = map_.block_count() - before;
  }

  BlockKey absolute(const BlockKey& at) const {
    const BlockKey& origin = start_.block;
    return {origin.x + at.x, origin.y + at.y, origin.z + at.z};
  }

  Block& block_at(const BlockKey& at) { return map_.get_or_create(absolute(at)); }

  // False when nothing changed: all that the ping says was settled before.
  bool change(Block& block, const BlockEvidence& evidence) const {
    const IwloRule& rule = map_.rule();
    if (evidence.occupied.empty() && block.is_settled_free(rule)) return false;
    DenseVoxels& voxels = block.open(rule);
    bool changed = evidence.any_free && block.add_free(rule, evidence.free);
    for (const OccupiedVoxel& voxel : evidence.occupied) {
      std::int32_t& units = voxels.units[voxel.offset];
      std::uint16_t& count = voxels.count[voxel.offset];
      const Voxel before{units, count};
      rule.add(step_of(voxel, units, count), units, count);
      changed = changed || units != before.units || count != before.count;
    }
    block.close(rule);
    return changed;
  }

  double step_of(const OccupiedVoxel& voxel, std::int32_t units, std::uint16_t count) const {
    const double log_odds = log_odds_of(units);
    const double up = map_.rule().occupied_step(log_odds, count, voxel.weight);
    if (settings_.aggregation == Aggregation::occupied_first) return up;
    const double down = map_.rule().free_step(log_odds, count);
    return voxel.share * up + (1.0 - voxel.share) * down;
  }

  void count(const BlockEvidence& evidence) {
    stats_.occupied += evidence.occupied.size();
    for (std::uint32_t row : evidence.free) {
      for (; row != 0; row &= row - 1) ++stats_.free;
    }
  }

  VoxelMap& map_;
  const FanSettings& settings_;
  double block_m_;
  BlockPose start_;
  Fan fan_;
  std::vector<BlockKey> free_;     // blocks that are wholly free, relative to the sonar's
  std::vector<BlockKey> crossed_;  // and those that have to be looked at
  std::vector<BlockEvidence> evidence_;
  PingStats stats_;
};

}  // namespace

BlockPose at_transmission(const Transform& map_T_sonar, const PingMotion& motion, double block_m) {
  BlockPose start{{}, map_T_sonar};
  const auto split = [block_m](double& position, std::int32_t& block) {
    const double whole = std::floor(position / block_m);
    block += static_cast<std::int32_t>(whole);
    position -= whole * block_m;
  };
  Vec3& at = start.block_T_sonar.translation;
  const auto split_all = [&] {
    split(at.x, start.block.x);
    split(at.y, start.block.y);
    split(at.z, start.block.z);
  };
  split_all();
  if (!motion.any()) return start;
  start.block_T_sonar = turned_to_transmission(start.block_T_sonar, motion);
  at = at - motion.valid_s * motion.linear_mps;
  split_all();
  return start;
}

void check_reach(const VoxelMap& map, const Transform& map_T_sonar, double max_range_m,
                 const PingMotion& motion) {
  check_motion(motion, max_range_m);
  const double block_m = map.resolution_m() * kBlockEdge;
  // A moving sonar was elsewhere, and what it sees is nearer by less than a fiftieth.
  const double reach_m =
      motion.any() ? 1.02 * max_range_m + std::abs(motion.valid_s) * norm(motion.linear_mps)
                   : max_range_m;
  const Vec3& at = map_T_sonar.translation;
  for (const double position : {at.x, at.y, at.z}) {
    if (!std::isfinite(position)) throw std::invalid_argument("map_T_sonar is not finite");
    if ((std::abs(position) + reach_m) / block_m + 2 > kMaxBlock) {
      throw std::out_of_range("the ping lies beyond the map's reach");
    }
  }
  const auto& [x, y, z] = map_T_sonar.rows;
  const auto zero = [](double v) { return std::abs(v) < 1e-6; };
  const double handedness =
      dot(x, {y.y * z.z - y.z * z.y, y.z * z.x - y.x * z.z, y.x * z.y - y.y * z.x});
  if (!(zero(norm(x) - 1) && zero(norm(y) - 1) && zero(norm(z) - 1) && zero(dot(x, y)) &&
        zero(dot(y, z)) && zero(dot(z, x)) && handedness > 0)) {
    throw std::invalid_argument("map_T_sonar is no rigid transform");
  }
}

PingStats integrate_projective(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
                               const FanSettings& settings, const PingMotion& motion) {
  check_ping(image, settings);
  check_reach(map, map_T_sonar, image.max_range_m(), motion);
  return PingUpdate(map, image, map_T_sonar, settings, motion).run();
}

}  // namespace mapperd::map
