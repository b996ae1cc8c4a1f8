// Times the filter and the plain loops in turn on a harbour of 10^6 cells and a scan of 60 beams;
// writes one JSON object a line. CPU time, best and median of the repetitions.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <string>
#include <utility>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/gaussian.hpp"
#include "mapperd/localization/particle_filter.hpp"
#include "plain.hpp"

namespace {

using namespace mapperd;
using namespace mapperd::localization;

constexpr std::size_t kSide = 1000;
constexpr double kResolution_m = 0.1;
constexpr double kMaxRange_m = 40.0;
const Pose2 kTruth{-3.0, 2.0, 1.25};

void box(OccupancyGrid& grid, double x0, double y0, double x1, double y1) {
  const auto cell = [](double at) {
    return static_cast<std::size_t>(std::clamp((at + 50.0) / kResolution_m, 0.0, 999.0));
  };
  for (std::size_t r = cell(y0); r <= cell(y1); ++r) {
    for (std::size_t c = cell(x0); c <= cell(x1); ++c) grid.cells[r * kSide + c] = kOccupied;
  }
}

// A quay, a breakwater that steps away from it, two rows of piles, boulders.
OccupancyGrid harbour() {
  OccupancyGrid grid{{kSide, kSide, kResolution_m, {-50.0, -50.0, 0.0}},
                     std::vector<std::int8_t>(kSide * kSide, kFree)};
  box(grid, -50, 30, 50, 32);
  box(grid, -42, -50, -40, 50);
  for (int k = 0; k < 30; ++k) {
    box(grid, 20.0 + 0.5 * k, -40.0 + 2.0 * k, 21.5 + 0.5 * k, -38.0 + 2.0 * k);
    box(grid, -30.0 + 2.5 * k, 20.0, -29.6 + 2.5 * k, 20.4);
    box(grid, -30.0 + 2.5 * k, -25.0, -29.6 + 2.5 * k, -24.6);
    box(grid, -35.0 + 7.3 * (k % 9), -45.0 + 8.7 * (k % 7), -34.5 + 7.3 * (k % 9),
        -44.6 + 8.7 * (k % 7));
  }
  return grid;
}

// The last kSide * kSide bytes of a file, as a .npy file of int8 has its cells.
OccupancyGrid read_map(const char* path) {
  OccupancyGrid grid{{kSide, kSide, kResolution_m, {-50.0, -50.0, 0.0}},
                     std::vector<std::int8_t>(kSide * kSide)};
  std::FILE* file = std::fopen(path, "rb");
  const bool sought =
      file != nullptr && std::fseek(file, -static_cast<long>(kSide * kSide), SEEK_END) == 0;
  const bool read =
      sought && std::fread(grid.cells.data(), 1, kSide * kSide, file) == kSide * kSide;
  if (file != nullptr) std::fclose(file);
  if (!read) {
    std::fprintf(stderr, "cannot read %s\n", path);
    std::exit(1);
  }
  return grid;
}

// Exactly 60 ends over 130 degrees; every sixth an outlier.
Endpoints scan_of(const RangeMap& map) {
  Endpoints ends;
  for (int j = 0; j < 60; ++j) {
    const double bearing = (-65.0 + 130.0 * j / 59.0) * kPi / 180.0;
    const double seen = map.cast({kTruth.x, kTruth.y, kTruth.yaw + bearing}, kMaxRange_m);
    const double range = j % 6 == 5 || seen <= 0.0 || seen >= kMaxRange_m ? 3.0 + 0.5 * j : seen;
    ends.x_m.push_back(range * std::cos(bearing));
    ends.y_m.push_back(range * std::sin(bearing));
    ends.quality.push_back(1.0);
  }
  return ends;
}

double cpu_s() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

struct Contender {
  std::string name;
  std::function<void()> prepare;  // not timed
  std::function<void()> work;
};

// In turn, so that a busy machine is busy for all.
void time_all(const std::string& what, std::size_t particles, int repetitions,
              const std::vector<Contender>& contenders) {
  std::vector<std::vector<double>> laps(contenders.size());
  for (int k = 0; k < repetitions; ++k) {
    for (std::size_t i = 0; i < contenders.size(); ++i) {
      contenders[i].prepare();
      const double start = cpu_s();
      contenders[i].work();
      laps[i].push_back(cpu_s() - start);
    }
  }
  for (std::size_t i = 0; i < contenders.size(); ++i) {
    std::sort(laps[i].begin(), laps[i].end());
    std::printf(
        "{\"what\": \"%s\", \"particles\": %zu, \"who\": \"%s\", \"best_us\": %.3f, "
        "\"median_us\": %.3f}\n",
        what.c_str(), particles, contenders[i].name.c_str(), 1e6 * laps[i].front(),
        1e6 * laps[i][laps[i].size() / 2]);
  }
  std::fflush(stdout);
}

struct Bench {
  OccupancyGrid grid;
  RangeMap ranges{grid, false, 1};
  HitModel hits{0.5, 0.5, 0.2, kMaxRange_m, 2.0};
  LikelihoodField field{grid, hits, {}, 1};
  std::vector<float> plain_field = plain::field_of(grid, hits);
  Endpoints ends = scan_of(ranges);
  Beams beams;
  BeamModel mixture;
  MotionDraws draws = motion_draws(MotionModel::kDifferential, {0, 0, 0}, {0.28, 0.1, 0.12},
                                   {0.2, 0.2, 0.2, 0.2, 0.2});

  explicit Bench(OccupancyGrid map) : grid(std::move(map)) {
    mixture.max_range_m = kMaxRange_m;
    for (std::size_t j = 0; j < ends.beams(); ++j) {
      beams.bearing_rad.push_back(std::atan2(ends.y_m[j], ends.x_m[j]));
      beams.range_m.push_back(std::hypot(ends.x_m[j], ends.y_m[j]));
      beams.quality.push_back(1.0);
    }
  }

  Particles cloud(std::size_t count) const {
    Particles particles;
    particles.resize(count);
    draw_about(kTruth, {{{0.5, 0, 0}, {0, 0.707, 0}, {0, 0, 0.1}}}, {1, 1}, particles);
    return particles;
  }

  void weighting(std::size_t count, int repetitions) const {
    const Particles particles = cloud(count);
    plain::Cloud other = plain::cloud_of(particles);
    std::vector<double> logs(count);
    const auto none = [] {};
    const auto ours = [&](BeamAggregation aggregation) {
      return [&, aggregation] {
        field_log_likelihoods(field, ends, aggregation, 1.0, particles, 0, count, logs.data());
      };
    };
    const auto theirs = [&] {
      plain::weigh_field(other, grid.frame, plain_field, hits.density(2.0), ends.x_m, ends.y_m);
    };
    const auto restore = [&] { std::fill(other.weight.begin(), other.weight.end(), 1.0); };
    time_all("field weighting", count, repetitions,
             {{"plain", restore, theirs}, {"mapperd", none, ours(BeamAggregation::kCubeSum)}});
    time_all("product weighting", count, repetitions,
             {{"mapperd", none, ours(BeamAggregation::kProduct)}});
  }

  void beam_weighting(std::size_t count, int repetitions) const {
    const Particles particles = cloud(count);
    plain::Cloud other = plain::cloud_of(particles);
    std::vector<double> logs(count);
    time_all("beam weighting", count, repetitions,
             {{"plain", [&] { std::fill(other.weight.begin(), other.weight.end(), 1.0); },
               [&] { plain::weigh_beams(other, grid, mixture, ends.x_m, ends.y_m); }},
              {"mapperd", [] {},
               [&] {
                 beam_log_likelihoods(ranges, beams, mixture, BeamAggregation::kCubeSum, 1.0,
                                      particles, 0, count, logs.data());
               }}});
  }

  void step(std::size_t count, int repetitions) const {
    const Particles start = cloud(count);
    std::mt19937_64 generator(1);
    plain::Cloud other;
    FilterParams rule;
    rule.resample.min_particles = rule.resample.max_particles = count;
    ParticleFilter filter(rule, 1, 1);
    ParticleFilter independent(rule, 1, 1);
    rule.resample.scheme = Scheme::kMultinomial;
    independent.set_rule(rule);
    const auto one = [&](ParticleFilter& f) {
      return [&] {
        f.predict({0, 0, 0}, {0.28, 0.1, 0.12}, MotionModel::kDifferential,
                  {0.2, 0.2, 0.2, 0.2, 0.2}, {});
        f.weigh(field, ends, BeamAggregation::kCubeSum, 1.0);
        f.resample(nullptr);
      };
    };
    const auto plain_step = [&] {
      plain::move(other, draws, generator);
      plain::weigh_field(other, grid.frame, plain_field, hits.density(2.0), ends.x_m, ends.y_m);
      plain::normalise(other);
      plain::resample(other, generator);
    };
    time_all("field step", count, repetitions,
             {{"plain", [&] { other = plain::cloud_of(start); }, plain_step},
              {"mapperd", [&] { filter.start_with(start); }, one(filter)},
              {"mapperd multinomial", [&] { independent.start_with(start); }, one(independent)}});
  }

  void building(int repetitions) const {
    const auto none = [] {};
    time_all("field of 10^6 cells", 0, repetitions,
             {{"plain", none, [&] { static_cast<void>(plain::field_of(grid, hits)); }},
              {"mapperd", none, [&] { static_cast<void>(LikelihoodField(grid, hits, {}, 1)); }}});
    HitModel far = hits;
    far.max_distance_m = 100.0;
    time_all("field of 10^6 cells to 100 m", 0, repetitions,
             {{"mapperd", none, [&] { static_cast<void>(LikelihoodField(grid, far, {}, 1)); }}});
    time_all("range map of 10^6 cells", 0, repetitions,
             {{"mapperd", none, [&] { static_cast<void>(RangeMap(grid, false, 1)); }}});
  }
};

}  // namespace

int main(int argc, char** argv) {
  const int share = argc > 1 ? std::max(1, std::atoi(argv[1])) : 1;
  const Bench bench(argc > 2 ? read_map(argv[2]) : harbour());
  bench.building(std::max(3, 20 / share));
  for (const std::size_t count : {500U, 2000U, 10000U, 100000U}) {
    const int repetitions = static_cast<int>(std::max<std::size_t>(5, 400000 / count)) / share + 3;
    bench.weighting(count, repetitions);
    bench.step(count, repetitions);
    bench.beam_weighting(count, std::max(3, repetitions / 20));
  }
  return 0;
}
