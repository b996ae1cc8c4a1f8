// The IWLO rule against the published test vectors and its own limits.
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "check.hpp"
#include "mapperd/iwlo.hpp"

namespace {

using mapperd::IwloParams;
using mapperd::IwloRule;
using mapperd::log_odds_of;

IwloParams set_a() { return {}; }

IwloParams set_b() {
  IwloParams p;
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

TEST_CASE("a threshold at full scale gives no NaN") {
  IwloParams params = set_a();
  params.intensity_threshold = 255;
  const IwloRule rule(params);
  CHECK(rule.occupied_weight(255) == 0.0);
  CHECK_NEAR(rule.occupied_weight(300), 1 / (1 + std::exp(-1.5)), 1e-12);
  CHECK(rule.occupied_weight(std::numeric_limits<double>::quiet_NaN()) == 0.0);
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
  for (const std::int32_t start : {0, -12345, mapperd::units_of(-9.5)}) {
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
  for (const auto field :
       {&IwloParams::L_occ, &IwloParams::L_free, &IwloParams::L_min, &IwloParams::L_max,
        &IwloParams::sharpness, &IwloParams::decay_rate, &IwloParams::min_alpha,
        &IwloParams::intensity_threshold, &IwloParams::intensity_max,
        &IwloParams::adaptive_threshold, &IwloParams::adaptive_max_ratio}) {
    refuses(field, not_a_number);
  }
  refuses(&IwloParams::L_occ, -1);
  refuses(&IwloParams::L_free, 1);
  refuses(&IwloParams::min_alpha, 0);
  refuses(&IwloParams::min_alpha, 1.5);
  refuses(&IwloParams::decay_rate, 1e-5);  // 900 000 pings to settle
}

}  // namespace
