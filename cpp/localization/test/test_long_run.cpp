// Very many updates: nothing drifts, vanishes or becomes no number.
#include <cmath>
#include <cstdlib>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

// `make localization-soak` asks for ten millions.
long updates_wished() {
  const char* requested = std::getenv("MAPPERD_LONG_UPDATES");
  if (requested != nullptr) return std::atol(requested);
  return kSanitized ? 5000 : 100000;
}

TEST_CASE("a vehicle that circles for ever stays where it is, and its numbers sound") {
  const OccupancyGrid grid = basin();
  const RangeMap ranges(grid, false, 1);
  HitModel hits;
  hits.max_range_m = 30.0;
  const LikelihoodField field(grid, hits, {}, 1);
  const FreeSpace free(grid);
  FilterParams rule = sized(24, 24);
  rule.alpha_slow = 0.0001;
  rule.alpha_fast = 0.001;
  rule.resample_interval = 3;
  ParticleFilter filter(rule, 1, 1);
  constexpr int kStepsACircle = 40;
  std::vector<Pose2> circle;
  std::vector<Endpoints> scans;
  for (int k = 0; k < kStepsACircle; ++k) {
    const double angle = wrapped(2.0 * kPi * k / kStepsACircle);
    circle.push_back({5.0 * std::cos(angle), 5.0 * std::sin(angle), wrapped(angle + 0.5 * kPi)});
    scans.push_back(seen_from(ranges, circle.back(), 12, 30.0));
  }
  filter.start_about(circle[0], diagonal(0.01, 0.01, 0.001));
  const long updates = updates_wished();
  bool sound = true;
  double worst = 0.0;
  for (long k = 1; k <= updates; ++k) {
    const auto now = static_cast<std::size_t>(k % kStepsACircle);
    const auto before = static_cast<std::size_t>((k - 1) % kStepsACircle);
    filter.predict(circle[before], circle[now], MotionModel::kOmnidirectional,
                   {0.001, 0.001, 0.002, 0.002, 0.002}, {});
    sound = filter.weigh(field, scans[now], BeamAggregation::kProduct, 0.3).informative && sound;
    filter.resample_if_due(&free);
    if (k % 1000 != 0) continue;
    const Estimate e = filter.estimate();
    worst = std::max(worst, std::hypot(e.mean.x - circle[now].x, e.mean.y - circle[now].y));
    sound = sound && is_finite(e.mean) && std::isfinite(e.covariance[2][2]) &&
            std::abs(e.mass - 1.0) < 1e-9;
  }
  CHECK(sound);
  CHECK(worst < 1.0);
  CHECK(filter.counts().not_a_number == 0);
}

TEST_CASE("ten million reweightings leave weights of sum 1") {
  std::vector<double> log_weight{std::log(0.25), std::log(0.25), std::log(0.5)};
  const std::vector<double> likely{-1.0, -2.0, -300.0};
  const std::vector<double> unlikely{-2.0, -1.0, 300.0};
  for (int k = 0; k < (kSanitized ? 50'000 : 5'000'000); ++k) {
    reweight(log_weight, likely);
    reweight(log_weight, unlikely);
  }
  const auto weight = linear_weights(log_weight);
  CHECK(weight[0] + weight[1] + weight[2] == near(1.0, 1e-12));
  CHECK(weight[0] == near(weight[1], 1e-9));
}

TEST_CASE("a weight that is NaN becomes 0, and the others sum to 1") {
  std::vector<double> log_weight{std::log(0.5), std::nan(""), std::log(0.25)};
  const Reweighted done = reweight(log_weight, {-1.0, -1.0, -1.0});
  CHECK((done.informative && done.not_a_number == 0));
  const auto weight = linear_weights(log_weight);
  CHECK((weight[1] == 0.0 && std::isinf(log_weight[1])));
  CHECK(weight[0] == near(2.0 / 3.0, 1e-12));
  CHECK(done.log_evidence == near(std::log(0.75) - 1.0, 1e-12));
}

TEST_CASE("the effective size is that of weights of any sum, and 0 of none") {
  for (const double sum : {1e-9, 1.0, 7.0}) {
    CHECK(effective_size({0.25 * sum, 0.25 * sum, 0.25 * sum, 0.25 * sum}) == near(4.0, 1e-12));
    CHECK(effective_size({0.5 * sum, 0.0, 0.5 * sum}) == near(2.0, 1e-12));
  }
  CHECK((effective_size({}) == 0.0 && effective_size({0.0, 0.0}) == 0.0));
}

}  // namespace
