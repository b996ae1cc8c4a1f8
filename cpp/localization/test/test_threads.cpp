// One seed, one run: whatever the number of threads, bit by bit.
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

Particles run(int threads, std::uint64_t seed, bool beams) {
  const OccupancyGrid grid = basin();
  const RangeMap ranges(grid, false, threads);
  const LikelihoodField field(grid, {}, {}, threads);
  const FreeSpace free(grid);
  FilterParams rule = sized(700, 3000);
  rule.alpha_slow = 0.05;
  rule.alpha_fast = 0.5;
  ParticleFilter filter(rule, seed, threads);
  filter.start_about({0, 0, 0}, diagonal(0.5, 0.5, 0.1));
  Pose2 truth{0, 0, 0};
  for (int step = 0; step < 6; ++step) {
    const Pose2 next{truth.x + 0.3, truth.y + 0.1, truth.yaw + 0.1};
    const MotionModel model =
        step % 2 == 0 ? MotionModel::kDifferential : MotionModel::kOmnidirectional;
    filter.predict(truth, next, model, {0.1, 0.1, 0.1, 0.1, 0.1}, {0.01, 0.01});
    truth = next;
    // From the fourth step on the vehicle is elsewhere: random particles come.
    const Endpoints ends = seen_from(ranges, step < 3 ? truth : Pose2{9, -9, 2}, 24, 30.0);
    if (beams) {
      filter.weigh(ranges, beams_of(ends), {}, BeamAggregation::kProduct, 0.3);
    } else {
      filter.weigh(field, ends, BeamAggregation::kCubeSum, 1.0);
    }
    filter.resample_if_due(&free);
  }
  CHECK(filter.counts().injected_particles > 0);
  return filter.particles();
}

bool same(const Particles& a, const Particles& b) {
  return a.x == b.x && a.y == b.y && a.yaw == b.yaw && a.log_weight == b.log_weight;
}

TEST_CASE("one, two and five threads give the same bits; another seed does not") {
  for (const bool beams : {false, true}) {
    const Particles alone = run(1, 42, beams);
    CHECK(same(alone, run(2, 42, beams)));
    CHECK(same(alone, run(5, 42, beams)));
    CHECK(!same(alone, run(1, 43, beams)));
  }
}

}  // namespace
