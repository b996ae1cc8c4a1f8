#include "mapperd/map/evidence_integrator.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "mapperd/common/parallel.hpp"
#include "mapperd/map/evidence_grid.hpp"

namespace mapperd::map {
namespace {

// Blocks are worked on in cubes of so many along an edge: what one thread takes at once.
constexpr int kCubeBlocks = 4;

// Nearer than this many voxels range and bearing bend too much within a cell: each voxel is placed
// on its own. Beyond, the linear functions put some voxels into a neighbouring grid cell, at any
// detail: of test_evidence.cpp's voxels 2.9, 2.1, 1.7 and 1.5 % are of another class at detail 1,
// 2, 4 and 8.
constexpr float kNearVoxels = 24.0F;

// By how much, in voxels, what a moving sonar sees of a block may depart from a linear function of
// the place.
constexpr double kMaxBend = 0.05;

constexpr int kAhead = 2;  // cells that are fetched from memory before their turn

GridMemory& grid_memory() {
  static thread_local GridMemory memory;
  return memory;
}

struct Cube {
  BlockKey first;  // relative to the sonar's block
  int blocks;      // along an edge
};

// A block as the sonar sees it. Lengths in voxels.
struct BlockView {
  Vec3 centre;               // the map's axes, from the sonar, in metres
  Vec3 seen;                 // sonar frame
  std::array<Vec3, 3> step;  // what a voxel's step along the map's x, y, z is in the sonar frame
  bool is_linear;
};

// One ping. Coordinates are local to the sonar's block: far from the map's origin no precision is
// lost.
class PingUpdate {
 public:
  PingUpdate(VoxelMap& map, const PingImage& image, const Transform& map_T_sonar,
             const PingParams& settings, const PingMotion& motion)
      : map_(map),
        rule_(map.rule()),
        threads_(settings.threads),
        edge_m_(map.resolution_m()),
        block_m_(edge_m_ * kBlockEdge),
        start_(at_transmission(map_T_sonar, motion, block_m_)),
        grid_(grid_memory(), image, settings, map.rule(), edge_m_),
        low_side_{low_normal(grid_.low_sine())},
        high_side_{-1.0 * low_normal(grid_.high_sine())} {
    if (motion.any()) view_.emplace(motion, start_.block_T_sonar);
  }

  PingStats run() {
    if (grid_.is_empty()) return {};
    find_cubes();
    fetch();
    return apply();
  }

 private:
  struct CubeResult {
    PingStats stats;
    std::vector<Block> created;
  };

  // Of the plane through the sonar's vertical axis and a bearing; points to larger bearings.
  static Vec3 low_normal(double sine) {
    return {-sine, -std::sqrt(std::max(0.0, 1.0 - sine * sine)), 0.0};
  }

  BlockKey absolute(const BlockKey& at) const {
    const BlockKey& origin = start_.block;
    return {origin.x + at.x, origin.y + at.y, origin.z + at.z};
  }

  Vec3 to_sonar(const Vec3& v) const { return start_.block_T_sonar.rotate_back(v); }

  Vec3 centre_of(const Cube& cube) const {
    const double half = 0.5 * cube.blocks;
    return Vec3{(cube.first.x + half) * block_m_, (cube.first.y + half) * block_m_,
                (cube.first.z + half) * block_m_} -
           start_.block_T_sonar.translation;
  }

  // Whether a cube shares space with the fan, by the ball around it.
  bool may_be_seen(const Cube& cube) const {
    const BlockKey low = absolute(cube.first);
    const int rest = cube.blocks - 1;
    if (!map_.limit().meets(low, {low.x + rest, low.y + rest, low.z + rest})) return false;
    const Vec3 centre = centre_of(cube);
    double radius = 0.8661 * cube.blocks * block_m_;
    Vec3 seen = centre;
    if (view_) {
      const MotionBound bound = view_->motion_bound(centre, radius);
      seen = view_->seen(centre);
      radius += 2 * bound.stretch * radius;
    }
    const Vec3 v = to_sonar(seen);
    const double reach = radius + edge_m_;  // of footprints, and beyond the aperture's faces
    const double horizontal = std::sqrt(v.x * v.x + v.y * v.y);
    const double range = std::sqrt(horizontal * horizontal + v.z * v.z);
    return range - radius < grid_.reach_m() && range + reach > grid_.min_range_m() &&
           horizontal * grid_.sin_half_aperture() - std::abs(v.z) * grid_.cos_half_aperture() >
               -reach &&
           v.x > -radius && dot(v, low_side_) > -reach && dot(v, high_side_) > -reach;
  }

  void find_cubes() {
    int blocks = kCubeBlocks;
    while (blocks * block_m_ < 1.02 * grid_.reach_m() + block_m_) blocks *= 2;
    for (int octant = 0; octant < 8; ++octant) {
      const auto low = [&](int bit) { return (octant >> bit & 1) != 0 ? 0 : -blocks; };
      visit(
          {{low(0), low(1), low(2)}, blocks}, [&](const Cube& cube) { cubes_.push_back(cube); },
          kCubeBlocks);
    }
  }

  // All cubes of `smallest` blocks in a cube that may be seen.
  template <typename Found>
  void visit(const Cube& cube, const Found& found, int smallest) const {
    if (!may_be_seen(cube)) return;
    if (cube.blocks == smallest) return found(cube);
    const int half = cube.blocks / 2;
    const BlockKey& at = cube.first;
    for (int child = 0; child < 8; ++child) {
      visit({{at.x + half * (child & 1), at.y + half * (child >> 1 & 1),
              at.z + half * (child >> 2 & 1)},
             half},
            found, smallest);
    }
  }

  // All blocks that may be changed come into memory before anything is changed: the ping counts
  // wholly or not.
  void fetch() const {
    if (!map_.residency().is_partial()) return;
    std::vector<BlockKey> blocks;
    for (const Cube& cube : cubes_) {
      visit(
          cube,
          [&](const Cube& block) {
            if (classes_of(view_of(block)) != kHasNothing) blocks.push_back(absolute(block.first));
          },
          1);
    }
    map_.residency().fetch(blocks);
  }

  BlockView view_of(const Cube& block) const {
    BlockView view{centre_of(block), {}, {}, true};
    Vec3 seen = view.centre;
    SeenAxes axes;
    if (view_) {
      const Seen apparent = view_->look(view.centre);
      seen = apparent.at;
      axes = apparent.axes;
      view.is_linear =
          view_->motion_bound(view.centre, 0.8661 * block_m_).bend <= kMaxBend * edge_m_;
    }
    view.seen = (1.0 / edge_m_) * to_sonar(seen);
    view.step = {to_sonar(axes.x), to_sonar(axes.y), to_sonar(axes.z)};
    return view;
  }

  // Classes of evidence that the block may hold.
  std::uint8_t classes_of(const BlockView& view) const {
    const Vec3& v = view.seen;
    const double horizontal = std::max(std::sqrt(v.x * v.x + v.y * v.y), 1e-12);
    return grid_.classes_of_block(edge_m_ * std::sqrt(horizontal * horizontal + v.z * v.z),
                                  -v.y / horizontal);
  }

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

  void update(const Cube& cube, CubeResult& result) {
    CellPool::Cache pool(map_.pool());
    visit(cube, [&](const Cube& block) { update_block(block, pool, result); }, 1);
  }

  void update_block(const Cube& at, CellPool::Cache& pool, CubeResult& result) {
    const BlockView view = view_of(at);
    const std::uint8_t classes = classes_of(view);
    if (classes == kHasNothing) return;
    ++result.stats.blocks_visited;
    BlockUpdate update(*this, view, pool);
    if (classes == kHasFree && is_inside(view)) {
      update.free_cells = kAllCells;
    } else {
      update.find_cells();
    }
    if (update.free_cells == 0 && update.mixed.empty()) return;
    const BlockKey key = absolute(at.first);
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
      static_assert(CellPoints::kCount == kCellVoxels);
      const int corner = offset_of_cell(cell);
      for (int v = 0; v < kCellVoxels; ++v) {
        const int offset = corner + offset_in_cell(v);
        const auto from_middle = [](int at) { return at - (kBlockEdge - 1) / 2.0; };
        points.set(static_cast<std::size_t>(v),
                   view_.centre + ping_.edge_m_ * Vec3{from_middle(offset & 15),
                                                       from_middle(offset >> 4 & 15),
                                                       from_middle(offset >> 8)});
      }
      if (ping_.view_) ping_.view_->see(points);
      for (std::size_t v = 0; v < CellPoints::kCount; ++v) {
        points.set(v, ping_.to_sonar(points.at(v)));
      }
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
  double edge_m_;
  double block_m_;
  BlockPose start_;
  EvidenceGrid grid_;
  Vec3 low_side_;  // positive inside
  Vec3 high_side_;
  RuleTables tables_ = rule_.tables();
  const Kernels& kernels_ = kernels();
  GridView grid_view_ = grid_.view();
  CellsTask cells_task_ = grid_.cells_task();
  std::optional<MovingView> view_;
  std::vector<Cube> cubes_;
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
