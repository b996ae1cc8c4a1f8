// The IWLO rule against the published test vectors and its own limits.
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "mapperd/map/iwlo.hpp"

namespace {

using mapperd::map::IwloParams;
using mapperd::map::IwloRule;
using mapperd::map::log_odds_of;

// The published rule: no floor.
IwloParams set_a() {
  IwloParams p;
  p.adaptive_min_ratio = 0;
  return p;
}

IwloParams set_b() {
  IwloParams p = set_a();
  p.L_occ = 2;
  p.L_free = -4;
  p.sharpness = 0.1;
  p.min_alpha = 0.3;
  p.L_min = -12;
  p.L_max = 8;
  p.intensity_threshold = 100;
  return p;
}

struct Observation {
  double intensity;
  double factor;
  double expected;
};

void follow(const IwloParams& params, const std::vector<Observation>& observations) {
  const IwloRule rule(params);
  std::int32_t units = 0;
  std::uint16_t count = 0;
  for (const Observation& seen : observations) {
    const double step =
        rule.is_return(seen.intensity)
            ? rule.occupied_step(log_odds_of(units), count, rule.occupied_weight(seen.intensity))
            : rule.free_step(log_odds_of(units), count);
    rule.add(seen.factor * step, units, count);
    CHECK_NEAR(log_odds_of(units), seen.expected, 2e-6);
  }
}

TEST_CASE("the update reproduces the published vectors") {
  follow(set_a(), {{145, 1, 1.75},
                   {145, 1, 3.340909},
                   {145, 1, 4.799242},
                   {255, 1, 7.000404},
                   {0, 1, 6.354815},
                   {0, 1, 5.749956},
                   {145, 1, 6.843706},
                   {145, 1, 7.873118}});
  follow(set_a(), {{145, 3, 5.25}, {0, 2, 3.573774}, {145, 1, 5.032107}});
  follow(set_b(), {{150, 1, 0.991129},
                   {150, 1, 1.892156},
                   {150, 1, 2.718097},
                   {255, 1, 3.506554},
                   {0, 1, 2.532906},
                   {0, 1, 1.458195},
                   {150, 1, 2.077651},
                   {150, 1, 2.660668}});
  follow(set_b(), {{145, 3, 2.96855}, {0, 2, 0.289175}, {145, 1, 1.113773}});
}

constexpr double kOccupied = 0.8472978603872037;  // log-odds of p = 0.7
constexpr double kMiddle = 145;                   // half way from threshold to maximum: w = 0.5

struct Voxel {
  std::int32_t units = 0;
  std::uint16_t count = 0;
  double log_odds() const { return log_odds_of(units); }
};

Voxel seen_free(const IwloRule& rule, int pings) {
  Voxel voxel;
  for (int i = 0; i < pings; ++i) rule.add_free(voxel.units, voxel.count);
  return voxel;
}

void see_occupied(const IwloRule& rule, double intensity, Voxel& voxel) {
  const double weight = rule.occupied_weight(intensity);
  rule.add(rule.occupied_step(voxel.log_odds(), voxel.count, weight), voxel.units, voxel.count);
}

int pings_back(const IwloParams& params, int free_pings) {
  const IwloRule rule(params);
  Voxel voxel = seen_free(rule, free_pings);
  int pings = 0;
  for (; voxel.log_odds() <= kOccupied && pings < 300000; ++pings) {
    see_occupied(rule, kMiddle, voxel);
  }
  return pings;
}

TEST_CASE("without a floor a voxel once believed free is held there, as published") {
  CHECK(pings_back(set_a(), 1) == 84);
  CHECK(pings_back(set_a(), 2) == 2850);
  // 209 764 in real numbers; steps of 80 units of log-odds are rounded to whole ones.
  CHECK_NEAR(pings_back(set_a(), 5), 210000, 1000);
}

TEST_CASE("a changed voxel is seen within 30 pings, however long it was free") {
  for (const int free_pings : {1, 2, 3, 4, 5, 7, 10, 20, 30, 50, 90, 100, 1000, 10000}) {
    CHECK(pings_back({}, free_pings) <= 30);
  }
  CHECK(pings_back({}, 10000) == 28);
  IwloParams lower;
  lower.adaptive_min_ratio = 0.2;
  CHECK(pings_back(lower, 10000) > 30);
}

TEST_CASE("one false return at full intensity does not make free water anything else") {
  const IwloRule rule{IwloParams{}};
  for (const int free_pings : {1, 2, 5, 30, 1000}) {
    Voxel voxel = seen_free(rule, free_pings);
    see_occupied(rule, 255, voxel);
    CHECK(voxel.log_odds() < -2);
  }
}

TEST_CASE("the floor is of rates below the threshold, and of nothing else") {
  const IwloRule rule{IwloParams{}};
  const IwloRule published(set_a());
  CHECK_NEAR(rule.occupied_step(-10, 90, 0.5), 3.5 * 0.5 * 0.25, 1e-12);
  CHECK_NEAR(rule.occupied_step(-10, 0, 0.5), 3.5 * 0.5 * 0.25, 1e-12);
  for (const int seen : {0, 1, 90}) {
    const auto count = static_cast<std::uint16_t>(seen);
    for (const double log_odds : {0.0, 0.1, 5.0, 10.0}) {
      CHECK(rule.occupied_step(log_odds, count, 0.5) ==
            published.occupied_step(log_odds, count, 0.5));
    }
    for (const double log_odds : {-10.0, -0.1, 0.0, 0.1, 5.0, 10.0}) {
      CHECK(rule.free_step(log_odds, count) == published.free_step(log_odds, count));
    }
  }
  // Above the floor the published scale holds.
  CHECK(rule.occupied_step(-0.01, 0, 1) == published.occupied_step(-0.01, 0, 1));
  IwloParams off;
  off.adaptive_update = false;
  CHECK_NEAR(IwloRule(off).occupied_step(-10, 90, 0.5), 3.5 * 0.5 * 0.1, 1e-12);
}

TEST_CASE("protect_occupied off leaves free steps unscaled") {
  IwloParams params = set_a();
  params.protect_occupied = false;
  const IwloRule rule(params);
  CHECK_NEAR(rule.free_step(8.0, 0), -3.0, 1e-12);
  CHECK(IwloRule(set_a()).free_step(8.0, 0) > -1.0);
}

TEST_CASE("counts stop, without loss, where alpha has settled") {
  const IwloRule rule(set_a());
  CHECK(rule.settled_count() == 90);
  std::int32_t units = 0;
  std::uint16_t count = 0;
  for (int i = 0; i < 1000; ++i) rule.add(0.0, units, count);
  CHECK(count == 90);
  CHECK_NEAR(rule.free_step(0.0, 90), -0.3, 1e-12);
  CHECK(rule.free_step(0.0, 89) < rule.free_step(0.0, 90));
  CHECK(rule.free_step(0.0, 60000) == rule.free_step(0.0, 90));
}

TEST_CASE(
    "the learning rate never falls below its least, and full scale may lie below the threshold") {
  IwloParams params;
  params.min_alpha = 0.3;  // reached between two counts
  const IwloRule rule(params);
  CHECK_NEAR(rule.free_step(-5.0, rule.settled_count()), 0.3 * params.L_free, 1e-15);
  params.intensity_threshold = 300.0;
  CHECK_NEAR(IwloRule(params).occupied_weight(310.0), 1.0 / (1.0 + std::exp(-1.5)), 1e-15);
}

TEST_CASE("a threshold at full scale gives no NaN") {
  IwloParams params = set_a();
  params.intensity_threshold = 255;
  const IwloRule rule(params);
  CHECK(rule.occupied_weight(255) == 0.0);
  CHECK_NEAR(rule.occupied_weight(300), 1 / (1 + std::exp(-1.5)), 1e-12);
  CHECK(rule.occupied_weight(std::numeric_limits<double>::quiet_NaN()) == 0.0);
}

TEST_CASE("an intensity above full scale weighs what full scale does") {
  const IwloRule rule{IwloParams{}};
  for (const double bright : {255.5, 300.0, 1e30}) {
    CHECK(rule.occupied_weight(bright) == rule.occupied_weight(255));
  }
}

TEST_CASE("steps are rounded to the nearest unit, free ones that are taken together too") {
  for (const double part : {0.4, 0.6, 1.4, 1.6, 2.9}) {
    std::int32_t up = 0, down = 0;
    std::uint16_t count = 0;
    const IwloRule rule{IwloParams{}};
    rule.add(part * mapperd::map::kLogOddsUnit, up, count);
    rule.add(-part * mapperd::map::kLogOddsUnit, down, count);
    CHECK(up == std::lround(part) && down == -up);
    IwloParams params;
    params.L_free = -part * mapperd::map::kLogOddsUnit;
    params.decay_rate = 0;
    std::int32_t together = 0;
    IwloRule(params).add_unscaled_free(together, count, 3);
    CHECK(together == -3 * std::lround(part));
  }
}

TEST_CASE("free steps that are taken together learn with each of them") {
  const IwloRule rule{IwloParams{}};
  double sum = 0.0;
  for (std::uint16_t seen = 0; seen < 3; ++seen) sum += rule.free_step(-5.0, seen);
  std::int32_t units = 0;
  std::uint16_t count = 0;
  rule.add_unscaled_free(units, count, 3);
  CHECK_NEAR(log_odds_of(units), sum, 1e-6);
  CHECK(count == 3);
}

TEST_CASE("free steps are taken together up to where protection begins") {
  for (const double threshold : {0.2, 0.5, 0.8}) {
    IwloParams params;
    params.adaptive_threshold = threshold;
    const IwloRule rule(params);
    const double limit = log_odds_of(rule.unscaled_up_to());
    CHECK(rule.free_step(limit - 0.01, 0) == params.L_free);
    CHECK(rule.free_step(limit + 0.01, 0) > params.L_free);
  }
}

TEST_CASE("log-odds stay inside the clamps") {
  const IwloRule rule(set_a());
  std::int32_t units = 0;
  std::uint16_t count = 0;
  for (int i = 0; i < 10000; ++i) {
    rule.add(rule.occupied_step(log_odds_of(units), count, 1), units, count);
  }
  CHECK(log_odds_of(units) == 10.0);
  for (int i = 0; i < 10000; ++i) rule.add_free(units, count);
  CHECK(log_odds_of(units) == -10.0);
}

TEST_CASE("free steps taken together are free steps one by one, to the bit") {
  IwloParams params;
  params.decay_rate = 0.037;
  const IwloRule rule(params);
  for (const std::int32_t start : {0, -12345, mapperd::map::units_of(-9.5)}) {
    for (std::uint16_t seen = 0; seen <= rule.settled_count();
         seen = static_cast<std::uint16_t>(seen + 7)) {
      std::int32_t one_by_one = start;
      std::uint16_t count = seen;
      for (std::uint32_t times = 0; times < 400; ++times) {
        std::int32_t together = start;
        std::uint16_t together_count = seen;
        rule.add_unscaled_free(together, together_count, times);
        CHECK(together == one_by_one && together_count == count);
        rule.add_free(one_by_one, count);
      }
    }
  }
}

TEST_CASE("parameters out of range are refused by name") {
  const auto refuses = [](double IwloParams::* field, double value) {
    IwloParams params;
    params.*field = value;
    CHECK_THROWS(IwloRule(params), std::invalid_argument);
  };
  const double not_a_number = std::numeric_limits<double>::quiet_NaN();
  for (const auto field : {&IwloParams::L_occ, &IwloParams::L_free, &IwloParams::L_min,
                           &IwloParams::L_max, &IwloParams::sharpness, &IwloParams::decay_rate,
                           &IwloParams::min_alpha, &IwloParams::intensity_threshold,
                           &IwloParams::intensity_max, &IwloParams::adaptive_threshold,
                           &IwloParams::adaptive_max_ratio, &IwloParams::adaptive_min_ratio}) {
    refuses(field, not_a_number);
  }
  refuses(&IwloParams::L_occ, -1);
  refuses(&IwloParams::L_free, 1);
  refuses(&IwloParams::min_alpha, 0);
  refuses(&IwloParams::min_alpha, 1.5);
  refuses(&IwloParams::adaptive_min_ratio, -0.1);
  refuses(&IwloParams::adaptive_min_ratio, 0.31);  // above max_ratio
  refuses(&IwloParams::adaptive_max_ratio, 0.24);  // below min_ratio
  refuses(&IwloParams::decay_rate, 1e-5);          // 900 000 pings to settle
}

}  // namespace
