// A million pings, at the ends of everything: what comes out is finite, inside the clamps, and the
// rule's, ping by ping. How near 16 bits are to the rule in real numbers is for test_iwlo.cpp.
#include <cmath>
#include <vector>

#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/snapshot.hpp"
#include "maps.hpp"
#include "oracle.hpp"
#include "rules.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::Voxel;
using mapperd::map::VoxelMap;

// Nearly all pings see a block free throughout, which is only counted; now and then some, or many
// in a row, have a surface in its first 64 voxels.
void million_into_block(const IwloParams& params) {
  const int pings = kSanitized ? 20000 : 1000000;
  VoxelMap map(0.1, params);
  const IwloRule& rule = map.rule();
  const std::int16_t full = rule.full_step_of_code(255);
  Voxel wall, water;
  const auto check_all = [&] {
    const mapperd::map::Block& block = *map.find({});
    for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) {
      CHECK(map.voxel(block, i) == (i < 64 ? wall : water));
    }
  };
  const auto see = [&](bool wall_there, std::int16_t& units, std::uint16_t& count) {
    if (!wall_there) return rule.add_free(units, count);
    rule.add(rule.occupied_units(units, count, full), units, count);
  };
  for (int ping = 0; ping < pings; ++ping) {
    const bool sees_wall = ping % 2000 == 0 || (ping >= pings / 2 && ping < pings / 2 + 300);
    if (sees_wall) {
      maps::change_block(map, {}, [&](int i, std::int16_t& units, std::uint16_t& count) {
        see(i < 64, units, count);
      });
    } else {
      maps::see_free(map, {});
    }
    see(sees_wall, wall.units, wall.count);
    see(false, water.units, water.count);
    CHECK((wall.units >= rule.min_units() && wall.units <= rule.max_units()));
    if (ping == 300 || ping == pings / 2 + 299 || ping % 99999 == 0) check_all();
  }
  check_all();
}

TEST_CASE("a million pings into one block, counted or opened, are those of its voxels") {
  million_into_block({});
  IwloParams all;  // threshold at full scale, no decay, alpha 1
  all.intensity_threshold = all.intensity_max = 254.0;
  all.decay_rate = 0.0;
  all.min_alpha = 1.0;
  million_into_block(all);
}

// Many pings of a sonar that does not move: each a step by the rule in real numbers.
void many_real_pings(const IwloParams& params, float dark, float bright, int pings) {
  oracle::Settings settings;
  settings.edge_m = 0.4;
  settings.iwlo = params;
  scenes::Ping ping = scenes::empty_ping(16, 6, 0.5, 4.0);
  for (std::size_t j = 0; j < 6; ++j) {
    for (std::size_t k = 0; k < 16; ++k) ping.intensity[k * 6 + j] = k == 13 ? bright : dark;
  }
  VoxelMap map(settings.edge_m, params);
  const mapperd::Transform pose = scenes::rotation_zyx(0.3, 0.2, 0.1);
  const IwloRule& rule = map.rule();
  for (int i = 0; i < pings; ++i) integrate_evidence_grid(map, ping.image(), pose, settings.ping);
  std::size_t occupied = 0, free = 0;
  map.for_each_known([&](const mapperd::map::VoxelIndex&, const mapperd::map::VoxelState& is) {
    const bool is_free = is.log_odds < 0;
    oracle::State state;
    const double weight = rule.occupied_weight(bright);
    for (int i = 0; i < pings; ++i) {
      oracle::update(state, {is_free ? 0.0 : 1.0, is_free ? 1.0 : 0.0, weight}, settings);
    }
    // On the way from one clamp to none the roundings of all steps add up, 1.55 units at most each,
    // before alpha makes them less; half a code of weight is as much as three.
    const double steps = std::min(pings, 40);
    CHECK(is.log_odds == near(state.log_odds, 2 * steps * rule.unit()));
    CHECK(is.count == std::min<int>(state.count, rule.settled_count()));
    ++(is_free ? free : occupied);
  });
  const bool returns = rule.is_return(bright);
  CHECK((returns ? occupied > 10 : occupied + free == 0));
  CHECK((!returns || dark > 0 || free > 20));
}

TEST_CASE("thousands of real pings of extreme images end where the rule does") {
  IwloParams full_scale, slow, unchanging;
  full_scale.intensity_threshold = 255.0;
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;
  unchanging.decay_rate = 0.0;
  unchanging.min_alpha = 1.0;
  unchanging.L_min = -127.0;
  unchanging.L_max = 127.0;
  many_real_pings({}, 0.0F, 255.0F, kSanitized ? 500 : 5000);
  for (const IwloParams& params : {IwloParams{}, full_scale, slow, unchanging}) {
    for (const int pings : {1, 10, 100}) {
      many_real_pings(params, 0.0F, 255.0F, pings);
      many_real_pings(params, 0.0F, 0.0F, pings);
      many_real_pings(params, 255.0F, 255.0F, pings);
    }
  }
}

}  // namespace
