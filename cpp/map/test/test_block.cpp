// Blocks: however the content is held, it is the same to the bit.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "mapperd/map/block.hpp"
#include "maps.hpp"
#include "rules.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::Block;
using mapperd::map::cell_bit;
using mapperd::map::CellPool;
using mapperd::map::CellSet;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::kAllCells;
using mapperd::map::kBlockCells;
using mapperd::map::kBlockVoxels;
using mapperd::map::kCellVoxels;
using mapperd::map::Voxel;
using mapperd::map::VoxelMap;

int cell_of(int offset) { return mapperd::map::cell_place(offset).cell; }

// A block, and the same block with every voxel on its own.
class Pair {
 public:
  explicit Pair(const IwloParams& params)
      : rule_(params), pool_(rule_.count_bytes()), block_({}, rule_), plain_(kBlockVoxels) {}

  void free(CellSet cells) {
    CellPool::Cache cache(pool_);
    const std::vector<Voxel> before = plain_;
    for (int i = 0; i < kBlockVoxels; ++i) {
      Voxel& voxel = plain_[static_cast<std::size_t>(i)];
      if ((cells & cell_bit(cell_of(i))) != 0) rule_.add_free(voxel.units, voxel.count);
    }
    const bool changed = block_.add_free(rule_, cache, cells);
    if (before != plain_) CHECK(changed);
  }

  // Opens a cell, as a ping with a surface in it does.
  template <typename Change>  // void(Voxel&)
  void change(int cell, int voxel, const Change& change_voxel) {
    CellPool::Cache cache(pool_);
    const mapperd::map::CellVoxels voxels = block_.open(rule_, cache, cell);
    Voxel changed{voxels.units()[voxel], voxels.count(voxel)};
    change_voxel(changed);
    voxels.units()[voxel] = changed.units;
    voxels.set_count(voxel, changed.count);
    block_.close(rule_, cache, cell);
    const int at = mapperd::map::offset_of_cell(cell) + mapperd::map::offset_in_cell(voxel);
    change_voxel(plain_[static_cast<std::size_t>(at)]);
  }

  void compare() const {
    mapperd::map::DenseVoxels dense;
    block_.copy_voxels(rule_, pool_, dense);
    int known = 0;
    bool equal = true;
    CellSet same = kAllCells;
    for (int i = 0; i < kBlockVoxels; ++i) {
      const auto at = static_cast<std::size_t>(i);
      equal = equal && block_.voxel(rule_, pool_, i) == plain_[at] &&
              Voxel{dense.units[at], dense.count[at]} == plain_[at];
      known += plain_[at].count > 0 ? 1 : 0;
      const auto first = static_cast<std::size_t>(mapperd::map::offset_of_cell(cell_of(i)));
      if (!(plain_[first] == plain_[at])) same &= ~cell_bit(cell_of(i));
    }
    CHECK(equal);
    CHECK(block_.known_count(pool_) == known);
    CHECK((block_.held() | same) == kAllCells);
    Voxel one;
    const bool all_alike = std::count(plain_.begin(), plain_.end(), plain_[0]) == kBlockVoxels;
    CHECK((!block_.all_alike(rule_, one) || (all_alike && one == plain_[0])));
    for (int cell = 0; cell < kBlockCells; ++cell) {
      const auto first = static_cast<std::size_t>(mapperd::map::offset_of_cell(cell));
      if (!block_.is_held(cell)) CHECK(block_.alike(rule_, cell) == plain_[first]);
      if ((block_.at_floor() & cell_bit(cell)) == 0) continue;
      CHECK((plain_[first] == Voxel{rule_.min_units(), rule_.settled_count()}));
    }
    CHECK(pool_.in_use() == static_cast<std::size_t>(__builtin_popcountll(block_.held())));
  }

  const IwloRule& rule() const { return rule_; }
  const Block& block() const { return block_; }

 private:
  IwloRule rule_;
  CellPool pool_;
  Block block_;
  std::vector<Voxel> plain_;
};

CellSet random_cells(scenes::Random& random) {
  CellSet cells = 0;
  for (int cell = 0; cell < kBlockCells; ++cell) {
    if (random.integer(0, 2) == 0) cells |= cell_bit(cell);
  }
  const int kind = random.integer(0, 3);
  return kind == 0 ? 0 : kind < 3 ? kAllCells : cells;
}

TEST_CASE("pending, opened and uniform cells hold the same bits as plain voxels") {
  std::uint64_t seed = 0;
  for (const IwloParams& params : rules::extreme()) {
    scenes::Random random(++seed);
    Pair pair(params);
    const IwloRule& rule = pair.rule();
    const int span = rule.max_units() - rule.min_units();
    for (int ping = 0; ping < (kSanitized ? 150 : 600); ++ping) {
      const int kind = random.integer(0, 9);
      if (kind < 7) pair.free(random_cells(random));
      for (int i = 0; kind >= 7 && i < 20; ++i) {
        // Far enough up, at times, that free steps are scaled and may not be kept pending.
        const int step = random.integer(-20, kind == 9 ? span : span / 50);
        pair.change(random.integer(0, kBlockCells - 1), random.integer(0, kCellVoxels - 1),
                    [&](Voxel& voxel) { rule.add(step, voxel.units, voxel.count); });
      }
      if (ping % 7 == 0) pair.compare();
    }
    for (int i = 0; i < 300; ++i) pair.free(kAllCells);  // more than are counted
    pair.compare();
  }
}

TEST_CASE("a cell that comes down from where steps are scaled takes one step a ping") {
  Pair pair({});
  for (int cell = 0; cell < kBlockCells; ++cell) {
    for (int v = 0; v < kCellVoxels; ++v) {  // alike in some cells, in others not
      pair.change(cell, v, [&](Voxel& voxel) {
        voxel = {static_cast<std::int16_t>(100 * cell + cell % 2 * v), 3};
      });
    }
  }
  for (int i = 0; i < 40; ++i) {
    pair.free(kAllCells);
    pair.compare();
  }
}

TEST_CASE("free space costs one state a cell, and a settled one does not change") {
  VoxelMap map(0.1, {});
  const std::uint32_t steps = map.rule().free_steps_to_floor();
  CHECK((steps > 90 && steps < 200));
  for (std::uint32_t i = 0; i < 300; ++i) CHECK(maps::see_free(map, {}) == (i < steps));
  const Block& block = *map.find({});
  CHECK((block.held() == 0 && map.held_count() == 0));
  CHECK(block.at_floor() == kAllCells);
  CHECK((block.alike(map.rule(), 9) == Voxel{map.rule().min_units(), map.rule().settled_count()}));
}

TEST_CASE("a cell that ends up free throughout gives its memory back") {
  VoxelMap map(0.1, {});
  map.set({5, 0, 0}, {0.5F, 1});
  CHECK(map.held_count() == kCellVoxels);
  for (int i = 0; i < 300; ++i) maps::see_free(map, {});
  CHECK((map.held_count() == 0 && !maps::see_free(map, {})));
  CHECK(map.at(mapperd::map::VoxelIndex{5, 0, 0}).log_odds == -10.0F);
}

TEST_CASE("where free steps change nothing, a block only counts") {
  IwloParams params;
  params.L_free = 0.0;
  VoxelMap map(0.1, params);
  map.set({5, 0, 0}, {-0.5F, 1});
  for (int i = 0; i < 1000000; ++i) maps::see_free(map, {});
  CHECK(map.held_count() == kCellVoxels);
  CHECK(map.at(mapperd::map::VoxelIndex{5, 0, 0}).log_odds == -0.5F);
  CHECK(map.at(mapperd::map::VoxelIndex{5, 0, 0}).count == map.rule().settled_count());
  CHECK(map.at(mapperd::map::VoxelIndex{0, 0, 0}).count == map.rule().settled_count());
}

TEST_CASE("slots that were given back are taken again before the pool grows") {
  VoxelMap map(0.1, {});
  for (int i = 0; i < 64; ++i) map.set({16 * i, 0, 0}, {1.0F, 1});
  const std::size_t bytes = map.pool().memory_bytes();
  for (int round = 0; round < 50; ++round) {
    CellPool::Cache pool(map.pool());
    for (int i = 0; i < 64; ++i) map.get_or_create({i, 0, 0}).clear(map.rule(), pool);
    CHECK(map.pool().in_use() <= 64);
    for (int i = 0; i < 64; ++i) pool.give_back(pool.take());
    CHECK(map.known_count() == 0);
  }
  for (int i = 0; i < 64; ++i) map.set({16 * i, 0, 0}, {1.0F, 1});
  CHECK((map.pool().memory_bytes() <= bytes + 2048 && map.held_count() == 64U * kCellVoxels));
}

}  // namespace
