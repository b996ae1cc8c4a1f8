#include "mapperd/map/evidence_integrator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "mapperd/common/parallel.hpp"
#include "mapperd/map/evidence_grid.hpp"
#include "mapperd/map/fan_blocks.hpp"

namespace mapperd::map {
namespace {

// Nearer than this many voxels range and bearing bend too much within a cell: each voxel is placed
// on its own. Beyond, the linear functions put some voxels into a neighbouring grid cell, at any
// detail: of test_evidence.cpp's voxels 2.9, 2.1, 1.7 and 1.5 % are of another class at detail 1,
// 2, 4 and 8.
constexpr float kNearVoxels = 24.0F;

constexpr int kAhead = 2;  // cells that are fetched from memory before their turn

GridMemory& grid_memory() {
  static thread_local GridMemory memory;
  return memory;
}

class PingUpdate {
 public:
  PingUpdate(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
             const PingParams& settings, const PingMotion& motion)
      : map_(map),
        rule_(map.rule()),
        threads_(settings.threads),
        grid_(grid_memory(), image, settings, map.rule(), map.resolution_m()),
        fan_(map, grid_, map_T_sonar, motion) {}

  PingStats run() {
    if (grid_.is_empty()) return {};
    cubes_ = fan_.cubes();
    fan_.fetch(map_, cubes_);
    return apply();
  }

 private:
  struct CubeResult {
    PingStats stats;
    std::vector<Block> created;
  };

  PingStats apply() {
    const WriteLock lock(map_);
    revision_ = map_.next_revision();
    map_.pool().reserve(cubes_.size() * kCubeBlocks * kCubeBlocks * kCubeBlocks * kBlockCells);
    std::vector<CubeResult> results(cubes_.size());
    run_parallel(cubes_.size(), threads_, [&](std::size_t i) { update(cubes_[i], results[i]); });
    PingStats stats;
    for (CubeResult& result : results) {
      stats.occupied += result.stats.occupied;
      stats.free += result.stats.free;
      stats.blocks_visited += result.stats.blocks_visited;
      stats.blocks_created += result.created.size();
      for (const Block& block : result.created) map_.insert(block);
    }
    return stats;
  }

  void update(const BlockCube& cube, CubeResult& result) {
    CellPool::Cache pool(map_.pool());
    fan_.visit(cube, [&](const BlockCube& block) { update_block(block, pool, result); }, 1);
  }

  void update_block(const BlockCube& at, CellPool::Cache& pool, CubeResult& result) {
    const BlockView view = fan_.view_of(at);
    const std::uint8_t classes = fan_.classes_of(view);
    if (classes == kHasNothing) return;
    ++result.stats.blocks_visited;
    BlockUpdate update(*this, view, pool);
    if (classes == kHasFree && is_inside(view)) {
      update.free_cells = kAllCells;
    } else {
      update.find_cells();
    }
    if (update.free_cells == 0 && update.mixed.empty()) return;
    const BlockKey key = fan_.absolute(at.first);
    Block* const known = map_.find(key);
    std::optional<Block> fresh;
    Block& block = known != nullptr ? *known : fresh.emplace(key, rule_);
    const bool changed = update.change(block, result.stats);
    if (changed) block.revision = revision_;
    if (fresh && changed) result.created.push_back(*fresh);
  }

  // Whether all of a block lies in front of the sonar and between the aperture's faces.
  bool is_inside(const BlockView& view) const {
    const Vec3& v = view.seen;
    const double inside = std::sqrt(v.x * v.x + v.y * v.y) * grid_.sin_half_aperture() -
                          std::abs(v.z) * grid_.cos_half_aperture();
    return inside > kBlockReach && v.x > kBlockReach;
  }

  // Update of one block: first the evidence in its cells, then the change.
  class BlockUpdate {
   public:
    BlockUpdate(const PingUpdate& ping, const BlockView& view, CellPool::Cache& pool)
        : ping_(ping), view_(view), pool_(pool) {}

    CellSet free_cells = 0;
    struct Mixed {
      std::uint8_t cell;
      bool near;
    };
    struct MixedCells {
      std::array<Mixed, kBlockCells> cells;
      int count = 0;
      bool empty() const { return count == 0; }
    } mixed;

    void find_cells() {
      task_ = ping_.cells_task_;
      constexpr double kFirstCell = -1.5 * kCellEdge;
      const Vec3 first = view_.seen + kFirstCell * (view_.step[0] + view_.step[1] + view_.step[2]);
      set(task_.first, first);
      for (std::size_t i = 0; i < 3; ++i) {
        set(task_.step[i], double{kCellEdge} * view_.step[i]);
        set(task_.voxel_step[i], view_.step[i]);
      }
      ping_.kernels_.place_cells(task_, ping_.grid_view_, places_);
      const bool all_near = !view_.is_linear || ping_.grid_.is_irregular();
      for (int cell = 0; cell < kBlockCells; ++cell) {
        const auto i = static_cast<std::size_t>(cell);
        const unsigned found = places_.classes[i];
        if (found == 0) continue;
        if (found == kHasFree) {
          free_cells |= cell_bit(cell);
          continue;
        }
        const bool near = all_near || (found & kNearAxis) != 0 || places_.range[i] < kNearVoxels;
        mixed.cells[static_cast<std::size_t>(mixed.count++)] = {static_cast<std::uint8_t>(cell),
                                                                near};
      }
    }

    bool change(Block& block, PingStats& stats) {
      bool changed = false;
      std::array<std::uint8_t, kCellVoxels> codes;
      std::array<std::uint8_t, kCellVoxels> shares{};
      std::uint8_t* const found_shares = ping_.grid_.averages() ? shares.data() : nullptr;
      for (int m = 0; m < mixed.count; ++m) {
        const Mixed& at = mixed.cells[static_cast<std::size_t>(m)];
        if (m + kAhead < mixed.count) {
          block.prefetch(pool_, mixed.cells[static_cast<std::size_t>(m + kAhead)].cell);
        }
        const CodeCounts found = at.near
                                     ? look_up_each(at.cell, codes.data(), shares.data())
                                     : ping_.kernels_.look_up(task_, ping_.grid_view_, places_,
                                                              at.cell, codes.data(), found_shares);
        stats.occupied += static_cast<std::size_t>(found.occupied);
        if (found.free == kCellVoxels) {
          free_cells |= cell_bit(at.cell);
          continue;
        }
        stats.free += static_cast<std::size_t>(found.free);
        if (found.occupied == 0 &&
            (found.free == 0 || (block.at_floor() & cell_bit(at.cell)) != 0)) {
          continue;
        }
        const CellVoxels voxels = block.open(ping_.rule_, pool_, at.cell);
        changed |= ping_.kernels_.apply(ping_.tables_, codes.data(), found_shares, voxels.units(),
                                        voxels.counts(), ping_.rule_.count_bytes());
        block.close(ping_.rule_, pool_, at.cell);
      }
      stats.free += static_cast<std::size_t>(__builtin_popcountll(free_cells)) * kCellVoxels;
      changed |= block.add_free(ping_.rule_, pool_, free_cells);
      return changed;
    }

   private:
    static void set(float* to, const Vec3& v) {
      to[0] = static_cast<float>(v.x);
      to[1] = static_cast<float>(v.y);
      to[2] = static_cast<float>(v.z);
    }

    CodeCounts look_up_each(int cell, std::uint8_t* codes, std::uint8_t* shares) const {
      CellPoints points;
      ping_.fan_.places_of(view_, cell, points);
      return ping_.grid_.at(points, codes, shares);
    }

    const PingUpdate& ping_;
    const BlockView& view_;
    CellPool::Cache& pool_;
    CellsTask task_;
    CellPlaces places_;
  };

  VoxelMap& map_;
  const IwloRule& rule_;
  int threads_;
  EvidenceGrid grid_;
  FanBlocks fan_;
  RuleTables tables_ = rule_.tables();
  const Kernels& kernels_ = kernels();
  GridView grid_view_ = grid_.view();
  CellsTask cells_task_ = grid_.cells_task();
  std::vector<BlockCube> cubes_;
  std::uint64_t revision_ = 0;
};

}  // namespace

PingStats integrate_evidence_grid(VoxelMap& map, const PingImage& image,
                                  const Transform& map_T_sonar, const PingParams& settings,
                                  const PingMotion& motion) {
  check_ping(image, settings);
  check_reach(map, map_T_sonar, image.max_range_m(), motion);
  return PingUpdate(map, image, map_T_sonar, settings, motion).run();
}

}  // namespace mapperd::map
