// A million pings, at the ends of everything: what comes out is finite, inside the clamps, and what
// the oracle's double precision says.
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "check.hpp"
#include "mapperd/map/projective.hpp"
#include "mapperd/map/snapshot.hpp"
#include "oracle.hpp"
#include "scenes.hpp"

namespace {

using mapperd::map::Block;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::Voxel;
using mapperd::map::VoxelMap;

constexpr int kPings = 1000000;

// The core rounds each step to whole units of 2^-24, by half a unit at most; the oracle does not
// round. A million roundings all of one sign would come to 0.03. Where steps depend on the log-odds
// a difference grows on the way from one clamp to the other, at most as p does (occupied steps go
// with p, from 4.5e-5 at L = -10 to 0.5), by 1e4; at the clamps both are equal again. Roundings
// differ in sign: what was found is below 1e-4, and ten times that is permitted.
constexpr double kPermitted = 1e-3;

struct Case {
  std::string name;
  IwloParams params;
};

// Threshold at full scale, no decay, alpha 1, one by one and together, at the default clamps, at
// the widest and at narrow ones.
std::vector<Case> extreme_rules() {
  std::vector<Case> rules;
  for (const double clamp : {10.0, 127.0, 0.25}) {
    for (int mask = 0; mask < 8; ++mask) {
      IwloParams p;
      p.L_min = -clamp;
      p.L_max = clamp;
      if ((mask & 1) != 0) p.intensity_threshold = p.intensity_max = 254.0;
      if ((mask & 2) != 0) p.decay_rate = 0.0;
      if ((mask & 4) != 0) p.min_alpha = 1.0;
      rules.push_back({"clamp " + std::to_string(clamp) + " mask " + std::to_string(mask), p});
    }
  }
  for (const double threshold : {0.0, 255.0}) {  // of 255, full scale: nothing is a return
    IwloParams p;
    p.intensity_threshold = threshold;
    rules.push_back({"threshold " + std::to_string(threshold), p});
  }
  IwloParams plain, unprotected, slow;
  plain.adaptive_update = false;
  unprotected.protect_occupied = false;
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;  // 49900 pings to settle
  rules.push_back({"not adaptive", plain});
  rules.push_back({"unprotected", unprotected});
  rules.push_back({"slow", slow});
  return rules;
}

// What an intensity says of a voxel that its row fills, in the oracle's words.
oracle::Parts parts_of(double intensity, const IwloParams& p) {
  oracle::Parts parts;
  if (!(intensity > p.intensity_threshold)) {
    parts.free = 1.0;
    return parts;
  }
  const double span = p.intensity_max - p.intensity_threshold;
  const double x = span > 0 ? std::min(1.0, (intensity - p.intensity_threshold) / span) : 1.0;
  parts.occupied = 1.0;
  parts.weighted = 1.0 / (1.0 + std::exp(-p.sharpness * (x - 0.5)));
  return parts;
}

void apply(double intensity, const IwloRule& rule, Voxel& voxel) {
  if (!rule.is_return(intensity)) return rule.add_free(voxel.units, voxel.count);
  const double weight = rule.occupied_weight(intensity);
  const double step = rule.occupied_step(mapperd::map::log_odds_of(voxel.units), voxel.count, weight);
  rule.add(step, voxel.units, voxel.count);
}

bool agrees(const Voxel& voxel, const oracle::State& state, const IwloRule& rule) {
  const double log_odds = mapperd::map::log_odds_of(voxel.units);
  return std::isfinite(log_odds) && log_odds >= rule.params().L_min &&
         log_odds <= rule.params().L_max && std::abs(log_odds - state.log_odds) <= kPermitted &&
         voxel.count == std::min<int>(state.count, rule.settled_count());
}

using Sequence = std::function<double(int ping)>;  // the intensity of each ping

void check_sequence(const Case& extreme, const char* kind, int pings, const Sequence& intensity) {
  const IwloRule rule(extreme.params);
  oracle::Settings settings;
  settings.iwlo = extreme.params;
  const oracle::Parts parts[] = {parts_of(0, extreme.params), parts_of(255, extreme.params)};
  Voxel voxel;
  oracle::State state;
  bool good = true;
  for (int ping = 0; ping < pings; ++ping) {
    const double seen = intensity(ping);
    apply(seen, rule, voxel);
    oracle::update(state, parts[seen > 0 ? 1 : 0], settings);
    good = good && agrees(voxel, state, rule);
  }
  if (!good) {
    check::fail(__FILE__, __LINE__,
                extreme.name + ", " + kind + ": " +
                    std::to_string(mapperd::map::log_odds_of(voxel.units)) + " not " +
                    std::to_string(state.log_odds));
  }
}

TEST_CASE("a million pings of one voxel are what the oracle says") {
  Case everything{"all at once", {}};
  everything.params.intensity_threshold = everything.params.intensity_max = 254.0;
  everything.params.decay_rate = 0.0;
  everything.params.min_alpha = 1.0;
  for (const Case& extreme : {Case{"default", {}}, everything}) {
    check_sequence(extreme, "between the clamps", kPings,
                   [](int ping) { return ping / 500 % 2 == 0 ? 255.0 : 0.0; });
    scenes::Random random(5);
    check_sequence(extreme, "at random", kPings,
                   [&random](int) { return random.integer(0, 1) * 255.0; });
  }
}

TEST_CASE("every extreme of the rule, alone and with others, is what the oracle says") {
  constexpr int kFewer = 20000;  // as many as there are until nothing changes any more, and more
  for (const Case& extreme : extreme_rules()) {
    scenes::Random random(6);
    check_sequence(extreme, "dark", kFewer, [](int) { return 0.0; });
    check_sequence(extreme, "bright", kFewer, [](int) { return 255.0; });
    check_sequence(extreme, "between the clamps", kFewer,
                   [](int ping) { return ping / 500 % 2 == 0 ? 255.0 : 0.0; });
    check_sequence(extreme, "at random", kFewer,
                   [&random](int) { return random.integer(0, 1) * 255.0; });
  }
}

// A million pings into one block: nearly all free throughout, which are only counted, and now and
// then some, or many in a row, with a surface in the first 64 voxels.
void million_into_block(const Case& extreme) {
  VoxelMap map(0.1, extreme.params);
  const IwloRule& rule = map.rule();
  Block& block = map.get_or_create({0, 0, 0});
  oracle::Settings settings;
  settings.iwlo = extreme.params;
  const oracle::Parts free_parts = parts_of(0, extreme.params);
  const oracle::Parts wall_parts = parts_of(255, extreme.params);
  oracle::State wall, water;
  const auto check_all = [&] {
    for (int i = 0; i < mapperd::map::kBlockVoxels; ++i) {
      CHECK(agrees(block.voxel(rule, i), i < 64 ? wall : water, rule));
    }
  };
  for (int ping = 0; ping < kPings; ++ping) {
    const bool sees_wall = ping % 2000 == 0 || (ping >= 500000 && ping < 500300);
    if (sees_wall) {
      auto& voxels = block.open(rule);
      for (std::size_t i = 0; i < mapperd::map::kBlockVoxels; ++i) {
        Voxel voxel{voxels.units[i], voxels.count[i]};
        apply(i < 64 ? 255.0 : 0.0, rule, voxel);
        voxels.units[i] = voxel.units;
        voxels.count[i] = voxel.count;
      }
      block.close(rule);
    } else {
      block.add_free_everywhere(rule);
    }
    oracle::update(wall, sees_wall ? wall_parts : free_parts, settings);
    oracle::update(water, free_parts, settings);
    if (ping == 300 || ping == 500299 || ping % 99999 == 0) check_all();
  }
  check_all();
}

TEST_CASE("a million pings into one block, counted or opened, are what the oracle says") {
  million_into_block({"default", {}});
  Case all{"threshold at full scale, no decay, alpha 1", {}};
  all.params.intensity_threshold = all.params.intensity_max = 254.0;
  all.params.decay_rate = 0.0;
  all.params.min_alpha = 1.0;
  million_into_block(all);
}

// Many pings of a sonar that does not move.
void many_real_pings(const IwloParams& params, float dark, float bright, int pings) {
  oracle::Settings settings;
  settings.resolution_m = 0.8;
  settings.iwlo = params;
  settings.rays_per_voxel = 60;
  scenes::Ping ping = scenes::empty_ping(8, 3, 0.5, 2.0);
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 8; ++k) ping.intensity[k * 3 + j] = k == 6 ? bright : dark;
  }
  VoxelMap map(settings.resolution_m, params);
  const mapperd::Transform pose = scenes::rotation_zyx(0.3, 0.2, 0.1);
  for (int i = 0; i < pings; ++i) integrate_projective(map, ping.image(), pose, settings.fan);
  std::size_t known = 0;
  for (const auto& [voxel, parts] : oracle::parts_of_ping(ping.image(), pose, settings)) {
    if (oracle::distance_to_limit(parts) < 0.01) continue;
    oracle::State state;
    for (int i = 0; i < pings; ++i) oracle::update(state, parts, settings);
    const mapperd::map::VoxelState is = map.at(mapperd::map::VoxelIndex{voxel[0], voxel[1], voxel[2]});
    CHECK(std::isfinite(is.log_odds));
    CHECK_NEAR(is.log_odds, state.log_odds, kPermitted);
    CHECK(is.count == std::min<int>(state.count, map.rule().settled_count()));
    known += is.count > 0 ? 1 : 0;
  }
  const bool sees_nothing = !map.rule().is_return(bright) && !map.rule().is_return(dark);
  CHECK(sees_nothing ? known_count(map) == 0 : known > 2);
}

TEST_CASE("thousands of real pings of extreme images end where the oracle does") {
  IwloParams full_scale, slow, unchanging;
  full_scale.intensity_threshold = 255.0;
  slow.decay_rate = 1e-2;
  slow.min_alpha = 2e-3;
  unchanging.decay_rate = 0.0;
  unchanging.min_alpha = 1.0;
  unchanging.L_min = -127.0;
  unchanging.L_max = 127.0;
  many_real_pings({}, 0.0F, 255.0F, check::sanitized() ? 500 : 5000);
  for (const IwloParams& params : {IwloParams{}, full_scale, slow, unchanging}) {
    many_real_pings(params, 0.0F, 255.0F, 100);
    many_real_pings(params, 0.0F, 0.0F, 100);
    many_real_pings(params, 255.0F, 255.0F, 100);
  }
}

}  // namespace
