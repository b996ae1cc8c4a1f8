// Blocks: however the content is held, it is the same to the bit.
#include <vector>

#include "check.hpp"
#include "mapperd/map/block.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::Block;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::Voxel;

// The same block, every voxel on its own.
class Plain {
 public:
  explicit Plain(const IwloRule& rule) : voxels(mapperd::map::kBlockVoxels), rule_(rule) {}
  void free_everywhere() {
    for (Voxel& voxel : voxels) rule_.add_free(voxel.units, voxel.count);
  }
  std::vector<Voxel> voxels;

 private:
  const IwloRule& rule_;
};

void check_equal(const Block& block, const Plain& plain, const IwloRule& rule) {
  for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) {
    const Voxel a = block.voxel(rule, i);
    const Voxel& b = plain.voxels[static_cast<std::size_t>(i)];
    CHECK(a.units == b.units && a.count == b.count);
  }
}

void run_random_updates(const IwloParams& params, std::uint64_t seed) {
  const IwloRule rule(params);
  scenes::Random random(seed);
  Block block({0, 0, 0});
  Plain plain(rule);
  for (int ping = 0; ping < 400; ++ping) {
    if (random.uniform(0, 1) < 0.8) {
      block.add_free_everywhere(rule);
      plain.free_everywhere();
    } else {
      auto& voxels = block.open(rule);
      const int updates = random.integer(1, 40);
      for (int i = 0; i < updates; ++i) {
        const auto at = static_cast<std::size_t>(random.integer(0, mapperd::map::kBlockVoxels - 1));
        // Far enough up, at times, that free steps are scaled and may not be kept pending.
        const double step = random.uniform(-1, 25);
        rule.add(step, voxels.units[at], voxels.count[at]);
        rule.add(step, plain.voxels[at].units, plain.voxels[at].count);
      }
      block.close(rule);
    }
    if (ping % 3 == 0) check_equal(block, plain, rule);
  }
  check_equal(block, plain, rule);
}

TEST_CASE("pending, opened and uniform blocks hold the same bits as plain voxels") {
  IwloParams params;
  run_random_updates(params, 1);
  params.adaptive_threshold = 0.3;
  run_random_updates(params, 2);
  params.adaptive_threshold = 0.8;
  run_random_updates(params, 3);
  params.adaptive_threshold = 1.0;
  run_random_updates(params, 4);
  params.adaptive_update = false;
  run_random_updates(params, 5);
  params = {};
  params.decay_rate = 0;
  run_random_updates(params, 6);
}

TEST_CASE("free space costs one state a block, and a settled one does not change") {
  const IwloRule rule{IwloParams{}};
  Block block({0, 0, 0});
  for (int i = 0; i < 90; ++i) CHECK(block.add_free_everywhere(rule));
  CHECK(!block.is_dense());
  CHECK(block.memory_bytes() < 100);
  CHECK(!block.add_free_everywhere(rule));
}

TEST_CASE("a block that ends up free throughout gives its memory back") {
  const IwloRule rule{IwloParams{}};
  Block block({0, 0, 0});
  auto& voxels = block.open(rule);
  rule.add(0.5, voxels.units[77], voxels.count[77]);
  block.close(rule);
  CHECK(block.is_dense());
  bool changed = true;
  for (int i = 0; i < 200 && changed; ++i) changed = block.add_free_everywhere(rule);
  CHECK(!changed);
  CHECK(!block.is_dense() && block.memory_bytes() < 100);
  CHECK(block.voxel(rule, 77).units == rule.min_units());
  CHECK(block.voxel(rule, 77).count == rule.settled_count());
}

TEST_CASE("free steps that are pending have observed every voxel") {
  const IwloRule rule{IwloParams{}};
  Block block({0, 0, 0});
  auto& voxels = block.open(rule);
  rule.add_free(voxels.units[77], voxels.count[77]);
  block.close(rule);
  CHECK(block.known_count() == 1);
  block.add_free_everywhere(rule);
  CHECK(block.is_dense() && block.known_count() == mapperd::map::kBlockVoxels);
}

TEST_CASE("where free steps say nothing, a block is only counted, for ever") {
  IwloParams params;
  params.L_free = 0.0;
  const IwloRule rule(params);
  Block block({0, 0, 0});
  auto& voxels = block.open(rule);
  rule.add(-0.5, voxels.units[77], voxels.count[77]);
  block.close(rule);
  for (int i = 0; i < 1000000; ++i) block.add_free_everywhere(rule);
  CHECK(block.is_dense());
  CHECK(block.voxel(rule, 77).units == mapperd::map::units_of(-0.5));
  CHECK(block.voxel(rule, 0).units == 0 && block.voxel(rule, 0).count == rule.settled_count());
}

}  // namespace
