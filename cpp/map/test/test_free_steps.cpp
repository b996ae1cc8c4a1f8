// Free steps of many voxels at once, against the rule applied to one voxel at a time.
#include <algorithm>
#include <cstdint>
#include <vector>

#include "check.hpp"
#include "mapperd/map/block.hpp"
#include "mapperd/map/kernels.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::Block;
using mapperd::map::DenseVoxels;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::kBlockVoxels;
using mapperd::map::VoxelRows;

// Usual ones, and those at the ends of what is allowed.
std::vector<IwloParams> parameters() {
  std::vector<IwloParams> all(8);
  all[1].L_min = -127;
  all[1].L_max = 127;
  all[1].L_free = -127;
  all[2].L_free = 0;
  all[3].decay_rate = 0;  // settled at the first observation
  all[3].L_min = -127;
  all[4].decay_rate = 1.0 / 65534.5;  // settled as late as a count can tell
  all[4].min_alpha = 0.5;
  all[5].adaptive_threshold = 1.0;
  all[5].L_max = 127;
  all[6].adaptive_update = false;
  all[6].L_min = -127;
  all[6].L_max = 127;
  all[7].adaptive_threshold = 0.2;
  all[7].L_free = -0.0001;
  return all;
}

std::int32_t random_units(const IwloRule& rule, scenes::Random& random) {
  const auto around = [&random](std::int64_t units) { return units + random.integer(-3, 3); };
  switch (random.integer(0, 5)) {
    case 0:
      return rule.clamped(around(rule.min_units()));
    case 1:
      return rule.clamped(around(rule.max_units()));
    case 2:
      return rule.clamped(around(rule.unscaled_up_to()));
    case 3:
      return rule.clamped(around(0));
    default:
      return rule.clamped(static_cast<std::int64_t>(
          random.uniform(rule.min_units(), static_cast<double>(rule.max_units()))));
  }
}

std::uint16_t random_count(const IwloRule& rule, scenes::Random& random) {
  const int settled = rule.settled_count();
  const int kind = random.integer(0, 3);
  if (kind == 0) return static_cast<std::uint16_t>(settled);
  if (kind == 1) return static_cast<std::uint16_t>(std::max(settled - random.integer(0, 3), 0));
  return static_cast<std::uint16_t>(random.integer(0, settled));
}

void fill(DenseVoxels& voxels, const IwloRule& rule, scenes::Random& random) {
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    voxels.units[i] = random_units(rule, random);
    voxels.count[i] = random_count(rule, random);
  }
}

VoxelRows random_rows(scenes::Random& random) {
  VoxelRows rows;
  for (std::uint16_t& row : rows) {
    const int kind = random.integer(0, 3);
    row = static_cast<std::uint16_t>(kind == 0 ? 0 : random.integer(0, 0xFFFF));
    if (kind == 1) row = 0xFFFF;
  }
  return rows;
}

bool taken(const VoxelRows& rows, std::size_t i) { return (rows[i / 16] >> (i % 16) & 1) != 0; }

TEST_CASE("the parameters reach both ends of the settled count") {
  int least = 65536;
  int most = 0;
  for (const IwloParams& params : parameters()) {
    least = std::min<int>(least, IwloRule(params).settled_count());
    most = std::max<int>(most, IwloRule(params).settled_count());
  }
  CHECK(least == 1 && most == 65535);
}

TEST_CASE("a block's free voxels are stepped as one by one, scaled or not") {
  scenes::Random random(61);
  for (const IwloParams& params : parameters()) {
    const IwloRule rule(params);
    for (int turn = 0; turn < 6; ++turn) {
      Block block({0, 0, 0});
      DenseVoxels& voxels = block.open(rule);
      fill(voxels, rule, random);
      const DenseVoxels before = voxels;
      const VoxelRows rows = random_rows(random);
      block.add_free(rule, rows);
      for (std::size_t i = 0; i < kBlockVoxels; ++i) {
        std::int32_t units = before.units[i];
        std::uint16_t count = before.count[i];
        if (taken(rows, i)) rule.add_free(units, count);
        CHECK(voxels.units[i] == units && voxels.count[i] == count);
      }
    }
  }
}

TEST_CASE("tables of many free steps are those steps one after another") {
  scenes::Random random(62);
  for (const IwloParams& params : parameters()) {
    const IwloRule rule(params);
    for (const std::uint32_t times : {1U, 2U, 5U, 91U, 1000U, 70000U, 4000000000U}) {
      const IwloRule::FreeSteps steps = rule.free_steps(times);
      CHECK(steps.down.size() == rule.settled_count() + 1U);
      for (int i = 0; i < 300; ++i) {
        const std::int32_t start = random_units(rule, random);
        const std::uint16_t seen = random_count(rule, random);
        std::int32_t units = start;
        std::uint16_t count = seen;
        rule.add_unscaled_free(units, count, times);
        const std::int64_t lowered = std::int64_t{start} - steps.down[seen];
        CHECK(rule.clamped(lowered) == units && steps.count[seen] == count);
        if (times > 91 || i >= 20 || !rule.is_unscaled(start)) continue;
        std::int32_t stepped = start;
        std::uint16_t stepped_count = seen;
        for (std::uint32_t t = 0; t < times; ++t) {
          rule.add(rule.free_step(mapperd::map::log_odds_of(stepped), stepped_count), stepped,
                   stepped_count);
        }
        CHECK(stepped == units && stepped_count == count);
      }
    }
  }
}

// One call of the kernel, against plain arithmetic in 64 bits.
void check_lower(const mapperd::map::Kernels& kernels, const IwloRule& rule, std::uint32_t times,
                 std::int32_t limit, scenes::Random& random) {
  DenseVoxels voxels;
  fill(voxels, rule, random);
  const DenseVoxels before = voxels;
  const VoxelRows rows = random_rows(random);
  const IwloRule::FreeSteps steps = rule.free_steps(times);
  const mapperd::map::Lowered lowered =
      kernels.lower(voxels.units.data(), voxels.count.data(), rows.data(), steps.down.data(),
                    steps.count.data(), rule.min_units(), limit);
  bool expected_above = false;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    std::int64_t units = before.units[i];
    std::uint32_t count = before.count[i];
    if (taken(rows, i) && before.units[i] > limit) expected_above = true;
    if (taken(rows, i) && before.units[i] <= limit) {
      units = std::max<std::int64_t>(units - steps.down[count], rule.min_units());
      count = steps.count[count];
    }
    CHECK(voxels.units[i] == units && voxels.count[i] == count);
  }
  CHECK(lowered.any_above == expected_above);
  CHECK(lowered.changed == (voxels.units != before.units || voxels.count != before.count));
}

TEST_CASE("the kernels lower what they are told to, to the clamp and no further") {
  scenes::Random random(63);
  for (const IwloParams& params : parameters()) {
    const IwloRule rule(params);
    for (const std::uint32_t times : {1U, 3U, 80U, 4000000000U}) {
      for (const std::int32_t limit :
           {rule.unscaled_up_to(), rule.min_units(), rule.max_units(), 0}) {
        check_lower(mapperd::map::kernels(), rule, times, limit, random);
        check_lower(mapperd::map::plain_kernels(), rule, times, limit, random);
      }
    }
  }
}

}  // namespace
