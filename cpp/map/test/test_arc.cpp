// The arc rule against its definition, evaluated voxel by voxel in double precision.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "mapperd/map/arc_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/merge.hpp"
#include "mapperd/map/point_updates.hpp"
#include "mapperd/map/snapshot.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Vec3;
using mapperd::map::ArcModel;
using mapperd::map::ArcParams;
using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::PingParams;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;

constexpr double kPrior = -2.944;
constexpr double kEdge = 0.1;

IwloParams rule_of(const ArcParams& params) {
  IwloParams rule;
  rule.prior = kPrior;
  rule.L_free = -ArcModel::free_step(params);
  rule.L_min = -3.0;
  rule.L_max = 9.0;
  rule.decay_rate = 1e-5;
  rule.min_alpha = 0.999;
  rule.adaptive_max_ratio = 1.0;  // no scale: the oracle has none
  rule.adaptive_min_ratio = 0.0;
  return rule;
}

struct Levels {
  scenes::Ping ping;
  std::vector<float> noise;
  mapperd::map::ArcImage image() const { return {ping.image(), noise.data()}; }
};

// Speckled surfaces over noise.
Levels random_levels(scenes::Random& random) {
  Levels levels{scenes::random_ping(random), {}};
  for (float& level : levels.ping.intensity) {
    const double noise = 0.03 * std::sqrt(-2.0 * std::log(random.uniform(1e-9, 1.0)));
    level = static_cast<float>(level / 100.0 + noise);
  }
  levels.noise.assign(levels.ping.rows, 0.035F);
  return levels;
}

double phi(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

// F of the header.
double surface_below(const ArcParams& p, double level, double sine) {
  const double x = 3.14159265358979 * 0.44295 / std::sin(p.beam_width_rad / 2) * 0.9 * sine;
  const double pattern = x < 1e-9 ? 1.0 : std::pow(std::sin(x) / x, 2);
  const double z = std::log(level / pattern);
  const double broad = std::clamp(std::log(level / 0.045) / std::log(7.5 / 0.045), 0.0, 1.0);
  return p.missed_share +
         (1 - p.missed_share) *
             ((1 - p.broad_share) * phi(z / (z < 0 ? p.spread_below : p.spread_above)) +
              p.broad_share * broad);
}

double noise_below(double level) { return level <= 3.5 ? 0.0 : 1.0 - std::pow(level / 3.5, -1.82); }

using Place = std::tuple<int, int, int>;

// The log-odds of all voxels that a ping changes.
std::map<Place, double> oracle(const VoxelMap& map, const ArcParams& p, const Levels& levels,
                               const mapperd::Transform& pose, bool carve) {
  const auto image = levels.ping.image();
  const auto edges = mapperd::map::beam_edge_sines(image.bearings_rad, image.beams);
  const auto beams = static_cast<int>(image.beams);
  const int rows = static_cast<int>(image.max_range_m() / kEdge);
  const double beam = (edges.back() - edges.front()) / beams;
  std::vector<int> group(static_cast<std::size_t>(rows), 1), first(image.beams, rows);
  std::vector<double> pooled(static_cast<std::size_t>(rows * beams), 0.0);
  for (int k = 0; k < rows; ++k) {
    auto& g = group[static_cast<std::size_t>(k)];
    while (2 * g * beam * (k + 0.5) <= 1.0 && g < 64) g *= 2;
    if (!((k + 1) * kEdge > 0.5)) continue;
    for (int j = 0; j < beams; j += g) {
      double level = 0;
      const int end = std::min(beams, j + g);
      for (std::size_t row = 0; row < image.rows; ++row) {
        const double near_m = static_cast<double>(row) * image.range_resolution_m;
        if (near_m + image.range_resolution_m <= k * kEdge || near_m >= (k + 1) * kEdge) continue;
        for (int b = j; b < end; ++b) {
          level = std::max(level, double{image.at(row, static_cast<std::size_t>(b))});
        }
      }
      for (int b = j; b < end; ++b) {
        pooled[static_cast<std::size_t>(k * beams + b)] = level;
        auto& at = first[static_cast<std::size_t>(b)];
        const double noise = double{levels.noise[0]};
        if (level >= std::max(p.first_return, 5.0 * noise) && at == rows) at = k;
      }
    }
  }
  struct Seen {
    Place place;
    double log_odds, sine, level, weight;
    int count;
    bool behind;
    std::pair<int, int> arc;
  };
  std::vector<Seen> all;
  std::map<std::pair<int, int>, std::pair<double, double>> sums;
  const double reach = image.max_range_m() / kEdge + 2;
  const Vec3 from = (1 / kEdge) * pose.translation;
  const double sin_half = std::sin(p.half_aperture_rad);
  const auto terms = [&](const Seen& v) {
    const double probability = 1 / (1 + std::exp(-v.log_odds));
    const auto term = [&](double level) {
      return std::log1p(-probability * (1 - surface_below(p, level, v.sine)));
    };
    return std::make_pair(term(1.15 * v.level + 0.015),
                          term(std::max(v.level / 1.15 - 0.015, 1e-6)));
  };
  for (int x = static_cast<int>(from.x - reach); x <= from.x + reach; ++x) {
    for (int y = static_cast<int>(from.y - reach); y <= from.y + reach; ++y) {
      for (int z = static_cast<int>(from.z - reach); z <= from.z + reach; ++z) {
        const Vec3 at =
            pose.rotate_back(kEdge * Vec3{x + 0.5, y + 0.5, z + 0.5} - pose.translation);
        const double flat = std::sqrt(at.x * at.x + at.y * at.y);
        const double range = std::sqrt(flat * flat + at.z * at.z);
        if (!(at.x > 0) || range < 0.5 || std::abs(at.z) / range >= sin_half) continue;
        const double sine = -at.y / flat;
        if (sine < edges.front() || sine >= edges.back()) continue;
        const int k = static_cast<int>(range / kEdge);
        if (k >= rows) continue;
        const auto after = std::upper_bound(edges.begin(), edges.end(), sine);
        const int b = static_cast<int>(after - edges.begin()) - 1;
        const double level = pooled[static_cast<std::size_t>(k * beams + b)];
        const bool behind = k > first[static_cast<std::size_t>(b)];
        const bool silent = level <= p.quiet * double{levels.noise[0]};
        if (silent && (behind || (!carve && first[static_cast<std::size_t>(b)] == rows))) continue;
        const VoxelState state = map.at(VoxelIndex{x, y, z});
        const int g = group[static_cast<std::size_t>(k)];
        Seen seen{{x, y, z},
                  state.count == 0 ? kPrior : double{state.log_odds},
                  std::abs(at.z) / range,
                  silent ? 0.0 : level,
                  1.0 / (g * beam * (k + 0.5)),
                  state.count,
                  behind,
                  {k, b / g}};
        if (!silent) {
          const auto [upper, lower] = terms(seen);
          sums[seen.arc].first += seen.weight * upper;
          sums[seen.arc].second += seen.weight * lower;
        }
        all.push_back(seen);
      }
    }
  }
  std::map<Place, double> updated;
  for (const Seen& v : all) {
    double step = -ArcModel::free_step(p);
    if (v.level > 0) {
      const auto own = terms(v);
      const auto& sum = sums[v.arc];
      const double over_noise = v.level / double{levels.noise[0]};
      const double upper =
          noise_below(1.15 * over_noise + 0.5) * std::exp(std::min(0.0, sum.first - own.first));
      const double lower =
          noise_below(over_noise / 1.15 - 0.5) * std::exp(std::min(0.0, sum.second - own.second));
      const double occupied =
          surface_below(p, 1.15 * v.level + 0.015, v.sine) * upper -
          surface_below(p, std::max(v.level / 1.15 - 0.015, 1e-6), v.sine) * lower;
      step = std::clamp(std::log(std::max(occupied, 1e-12) / std::max(upper - lower, 1e-12)),
                        -p.max_step, p.max_step);
      if (v.behind && v.count == 0 && step < p.min_step) continue;
      if (v.behind && step < 0) {
        if (v.log_odds <= kPrior) continue;
        step = std::max(step * p.behind_scale, kPrior - v.log_odds);
      }
    }
    updated[v.place] = std::clamp(v.log_odds + step, kPrior - 3.0, kPrior + 9.0);
  }
  return updated;
}

TEST_CASE("a ping changes the voxels as the definition of the arc rule says") {
  scenes::Random random(71);
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  for (int trial = 0; trial < 6; ++trial) {
    VoxelMap map(kEdge, rule);
    mapperd::Transform pose = scenes::random_pose(random);
    const double yaw = random.uniform(-3, 3), pitch = random.uniform(-1, 1);
    for (int ping = 0; ping < 4; ++ping) {
      const Levels levels = random_levels(random);
      PingParams settings;
      settings.carve_no_return = trial % 2 == 0;
      const auto expected = oracle(map, params, levels, pose, settings.carve_no_return);
      VoxelMap before(kEdge, rule);
      load_map(encode_map(map), before);
      integrate_arc(map, model, levels.image(), pose, settings);
      std::size_t compared = 0, off = 0;
      const auto compare = [&](const Place& place, double wanted) {
        const auto& [x, y, z] = place;
        const VoxelState now = map.at(VoxelIndex{x, y, z});
        const double found = now.count == 0 ? kPrior : double{now.log_odds};
        ++compared;
        // Levels are rounded to a twelfth of an octave, elevations to a 64th of the aperture.
        off += std::abs(found - wanted) > 0.15 ? 1 : 0;
      };
      for (const auto& [place, wanted] : expected) compare(place, wanted);
      map.for_each_known([&](const VoxelIndex& at, const VoxelState&) {
        const Place place{static_cast<int>(at.x), static_cast<int>(at.y), static_cast<int>(at.z)};
        if (expected.count(place) != 0) return;
        const VoxelState old = before.at(at);
        compare(place, old.count == 0 ? kPrior : double{old.log_odds});
      });
      CHECK(compared > 150);
      CHECK(static_cast<double>(off) < 0.02 * static_cast<double>(compared));
      const Vec3 place = pose.translation;
      pose = scenes::rotation_zyx(yaw + 0.1 * ping, pitch + 0.2 * ping, 0.3 * ping);
      pose.translation = place;
    }
  }
}

TEST_CASE("the arc rule gives the same bits on any number of threads") {
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  const auto mapped = [&](int threads) {
    scenes::Random random(72);
    VoxelMap map(0.05, rule);
    PingParams settings;
    settings.threads = threads;
    mapperd::map::PingMotion motion;
    motion.linear_mps = {1.0, 0.3, -0.2};
    motion.angular_radps = {0.1, 0.2, 0.3};
    motion.valid_s = 0.002;
    mapperd::Transform pose = scenes::rotation_zyx(0.3, 0.2, 0.1);
    for (int ping = 0; ping < 6; ++ping) {
      const Levels levels = random_levels(random);
      integrate_arc(map, model, levels.image(), pose, settings,
                    ping % 2 == 0 ? motion : mapperd::map::PingMotion{});
      pose.translation.x += 0.03;
    }
    return encode_map(map);
  };
  const auto one = mapped(1);
  CHECK(one.size() > 1000);
  CHECK(mapped(2) == one);
  CHECK(mapped(5) == one);
}

// Echoes of a small object on one arc, from two sides: only where both arcs meet it may be.
TEST_CASE("levels place an echo on the axis, and crossing arcs find the object") {
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  VoxelMap map(kEdge, rule);
  const auto echo = [&](double pitch_rad, float level) {
    Levels levels{scenes::empty_ping(100, 64, 0.5, 4.0), std::vector<float>(100, 0.03F)};
    std::fill(levels.ping.intensity.begin(), levels.ping.intensity.end(), 0.02F);
    for (std::size_t row = 75; row < 78; ++row) {
      for (std::size_t j = 31; j < 33; ++j) levels.ping.intensity[row * 64 + j] = level;
    }
    integrate_arc(map, model, levels.image(), scenes::rotation_zyx(0, pitch_rad, 0), {});
  };
  const auto at = [&](double elevation_rad) {
    return map.at(Vec3{3.06 * std::cos(elevation_rad), 0.01, 3.06 * std::sin(elevation_rad)});
  };
  echo(0.0, 1.0F);
  CHECK(at(0.0).log_odds > at(0.2).log_odds);
  // The same object lies 10 degrees under the axis now, and sounds quieter by the pattern.
  for (int i = 0; i < 4; ++i) echo(-0.1745, 0.5F);
  CHECK(at(0.0).log_odds > at(0.17).log_odds);
  CHECK(at(0.0).log_odds > at(-0.17).log_odds);
  CHECK(at(0.0).log_odds > kPrior + 1.0);
}

TEST_CASE("nothing behind a first return becomes free") {
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  scenes::Random random(73);
  VoxelMap map(kEdge, rule);
  Levels levels{scenes::empty_ping(100, 64, 0.5, 4.0), std::vector<float>(100, 0.03F)};
  for (std::size_t j = 0; j < 64; ++j) levels.ping.intensity[50 * 64 + j] = 1.0F;
  for (std::size_t i = 60 * 64; i < 100 * 64; ++i) {
    levels.ping.intensity[i] = static_cast<float>(random.uniform(0.0, 0.3));
  }
  for (int i = 0; i < 3; ++i) integrate_arc(map, model, levels.image(), {}, {});
  std::size_t before = 0, behind = 0;
  map.for_each_known([&](const VoxelIndex& at, const VoxelState& state) {
    const double range = mapperd::norm(map.centre_of(at));
    if (range < 1.9 && state.log_odds < kPrior - 1) ++before;
    if (range > 2.2 && double{state.log_odds} < kPrior - 1e-3) ++behind;
  });
  CHECK(before > 100);
  CHECK(behind == 0);
}

// Pings of two poses, mapped into a map, and what each changed.
struct TwoPings {
  ArcParams params;
  IwloParams rule = rule_of(params);
  ArcModel model{params, IwloRule(rule)};
  std::vector<Levels> levels;
  std::vector<mapperd::Transform> poses;
  std::vector<mapperd::map::ArcChanges> changes{2};
  PingParams settings;

  explicit TwoPings(std::uint64_t seed) {
    scenes::Random random(seed);
    for (int ping = 0; ping < 2; ++ping) {
      levels.push_back(random_levels(random));
      poses.push_back(scenes::rotation_zyx(0.1 * ping, 0.2 * ping, 0.1));
    }
  }
  void integrate(VoxelMap& map, std::size_t ping) {
    integrate_arc(map, model, levels[ping].image(), poses[ping], settings, {}, &changes[ping]);
  }
  void refine(VoxelMap& map, std::size_t ping) {
    refine_arc(map, model, levels[ping].image(), poses[ping], settings, {}, changes[ping]);
  }
};

TEST_CASE("a single ping is refined to what it was") {
  TwoPings pings(75);
  VoxelMap map(kEdge, pings.rule);
  pings.integrate(map, 0);
  const auto before = encode_map(map);
  CHECK(pings.changes[0].steps.size() > 1000);
  pings.refine(map, 0);
  CHECK(encode_map(map) == before);
}

// Its earlier evidence is taken out of the voxels on its arcs, and the ping integrated into that.
TEST_CASE("a refined ping is integrated as if it were the last") {
  for (const std::uint64_t seed : {76U, 77U, 78U}) {
    TwoPings pings(seed);
    VoxelMap map(kEdge, pings.rule), without(kEdge, pings.rule);
    pings.integrate(map, 0);
    std::map<Place, double> by_echoes;
    map.for_each_known([&](const VoxelIndex& at, const VoxelState& state) {
      const double step = double{state.log_odds} - kPrior;
      if (std::abs(step + ArcModel::free_step(pings.params)) < 1e-3) return;
      by_echoes[{static_cast<int>(at.x), static_cast<int>(at.y), static_cast<int>(at.z)}] = step;
    });
    pings.integrate(map, 1);
    load_map(encode_map(map), without);
    for (const auto& [place, step] : by_echoes) {
      const auto& [x, y, z] = place;
      const Vec3 centre = map.centre_of(VoxelIndex{x, y, z});
      const double value = double{map.at(VoxelIndex{x, y, z}).log_odds} - step;
      const double xyz[] = {centre.x, centre.y, centre.z};
      mapperd::map::set_log_odds(without, {xyz, 1}, &value);
    }
    const auto changes = pings.changes[0];
    pings.integrate(without, 0);
    pings.changes[0] = changes;
    const auto before = encode_map(map);
    pings.refine(map, 0);
    CHECK(encode_map(map) != before);
    CHECK(by_echoes.size() > 300);
    std::size_t off = 0;
    for (const auto& [place, step] : by_echoes) {
      const auto& [x, y, z] = place;
      const VoxelIndex at{x, y, z};
      off += std::abs(map.at(at).log_odds - without.at(at).log_odds) > 2e-3F ? 1 : 0;
    }
    CHECK(off == 0);
  }
}

TEST_CASE("refining gives the same bits on any number of threads") {
  const auto refined = [](int threads) {
    TwoPings pings(79);
    pings.settings.threads = threads;
    VoxelMap map(kEdge, pings.rule);
    for (const std::size_t ping : {0U, 1U}) pings.integrate(map, ping);
    for (const std::size_t ping : {1U, 0U}) pings.refine(map, ping);
    return encode_map(map);
  };
  const auto one = refined(1);
  CHECK(refined(2) == one);
  CHECK(refined(5) == one);
}

TEST_CASE("changes of another ping are refused, and the map stays") {
  TwoPings pings(80);
  VoxelMap map(kEdge, pings.rule);
  for (const std::size_t ping : {0U, 1U}) pings.integrate(map, ping);
  const auto before = encode_map(map);
  const mapperd::map::ArcChanges good = pings.changes[0];
  mapperd::map::ArcChanges one_less = good, moved = good, no_counts = good;
  one_less.steps.pop_back();
  no_counts.counts.clear();
  const auto some = std::find_if(moved.counts.begin(), moved.counts.end() - 1,
                                 [](std::uint32_t count) { return count > 0; });
  --some[0];
  ++some[1];
  for (const auto& wrong : {one_less, moved, no_counts, pings.changes[1]}) {
    pings.changes[0] = wrong;
    CHECK_THROWS_AS(pings.refine(map, 0), std::invalid_argument);
    CHECK(encode_map(map) == before);
  }
}

TEST_CASE("bad levels, noise and parameters are refused") {
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  VoxelMap map(kEdge, rule);
  Levels levels{scenes::empty_ping(10, 8, 0.5, 2.0), std::vector<float>(10, 0.03F)};
  levels.ping.intensity.assign(80, 1.0F);
  for (const float bad : {0.0F, -1.0F, std::nanf(""), INFINITY}) {
    Levels wrong = levels;
    wrong.noise[3] = bad;
    CHECK_THROWS_AS(integrate_arc(map, model, wrong.image(), {}, {}), std::invalid_argument);
  }
  mapperd::Transform pose;
  pose.translation.x = std::nan("");
  CHECK_THROWS_AS(integrate_arc(map, model, levels.image(), pose, {}), std::invalid_argument);
  CHECK(map.block_count() == 0);
  const auto refuses = [&](auto change) {
    ArcParams wrong;
    change(wrong);
    CHECK_THROWS_AS(ArcModel(wrong, IwloRule(rule)), std::invalid_argument);
  };
  refuses([](ArcParams& p) { p.half_aperture_rad = 0; });
  refuses([](ArcParams& p) { p.spread_above = std::nan(""); });
  refuses([](ArcParams& p) { p.missed_share = 0; });
  refuses([](ArcParams& p) { p.broad_share = 1; });
  refuses([](ArcParams& p) { p.max_step = 1e9; });
  VoxelMap part(kEdge, rule);
  part.limit_to({{0, 0, 0}, {1, 1, 1}});
  CHECK_THROWS_AS(integrate_arc(part, model, levels.image(), {}, {}), std::logic_error);
}

TEST_CASE("levels that are no numbers bring none into the map") {
  const ArcParams params;
  const IwloParams rule = rule_of(params);
  const ArcModel model(params, IwloRule(rule));
  VoxelMap map(kEdge, rule);
  Levels levels{scenes::empty_ping(20, 16, 0.5, 2.0), std::vector<float>(20, 0.03F)};
  const float values[] = {std::nanf(""), INFINITY, -INFINITY, 1e30F, 1.0F, 0.0F};
  for (std::size_t i = 0; i < levels.ping.intensity.size(); ++i) {
    levels.ping.intensity[i] = values[i % 6];
  }
  for (int i = 0; i < 3; ++i) integrate_arc(map, model, levels.image(), {}, {});
  map.for_each_known(
      [&](const VoxelIndex&, const VoxelState& state) { CHECK(std::isfinite(state.log_odds)); });
}

TEST_CASE("an unobserved voxel has the prior, and files keep evidence") {
  IwloParams rule = rule_of({});
  VoxelMap map(kEdge, rule);
  map.set(VoxelIndex{1, 2, 3}, {static_cast<float>(kPrior + 2.5), 7});
  CHECK(map.at(VoxelIndex{1, 2, 3}).log_odds == doctest::Approx(kPrior + 2.5).epsilon(1e-3));
  VoxelMap loaded(kEdge, rule);
  load_map(encode_map(map), loaded);
  CHECK(loaded.at(VoxelIndex{1, 2, 3}).log_odds == map.at(VoxelIndex{1, 2, 3}).log_odds);
  const double at[] = {0.5 * kEdge, 0.5 * kEdge, 0.5 * kEdge};
  const double value = -1.0;
  set_log_odds(map, {at, 1}, &value);
  CHECK(map.at(VoxelIndex{0, 0, 0}).log_odds == doctest::Approx(-1.0).epsilon(1e-3));
  const double step = 3.0;
  add_log_odds(map, {at, 1}, &step, {-2.0, 1.5});
  CHECK(map.at(VoxelIndex{0, 0, 0}).log_odds == doctest::Approx(1.5).epsilon(1e-3));
  const VoxelMap copy = with_rule(map, rule);
  CHECK(encode_map(copy) == encode_map(map));
  IwloParams other = rule;
  other.prior += 0.01;
  VoxelMap elsewhere(kEdge, other);
  CHECK_THROWS_WITH_AS(load_map(encode_map(map), elsewhere), doctest::Contains("priors"),
                       std::invalid_argument);
  CHECK_THROWS_AS(merge(elsewhere, {&map}), std::invalid_argument);
  CHECK(encode_map(VoxelMap(kEdge, {}))[8] == 1);
  CHECK(encode_map(map)[8] == 2);
  rule.prior = std::nan("");
  CHECK_THROWS_AS(VoxelMap(kEdge, rule), std::invalid_argument);
}

}  // namespace
