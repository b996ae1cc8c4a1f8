// Resampling: how often each particle comes, how many there are, and recovery.
#include <algorithm>
#include <cmath>
#include <map>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

std::vector<double> uneven(std::size_t count) {
  std::vector<double> weight;
  double sum = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    weight.push_back(i % 5 == 0 ? 0.0 : 1.0 + static_cast<double>(i % 7));
    sum += weight.back();
  }
  for (double& w : weight) w /= sum;
  return weight;
}

// Chi-square per degree of freedom of how often each parent came.
double chi_square(const std::vector<std::size_t>& parents, const std::vector<double>& weight) {
  std::vector<double> times(weight.size());
  for (const std::size_t parent : parents) times[parent] += 1.0;
  double chi = 0.0;
  int freedom = -1;
  for (std::size_t i = 0; i < weight.size(); ++i) {
    const double wanted = weight[i] * static_cast<double>(parents.size());
    if (wanted == 0.0) {
      CHECK(times[i] == 0.0);
      continue;
    }
    chi += (times[i] - wanted) * (times[i] - wanted) / wanted;
    ++freedom;
  }
  return chi / freedom;
}

Particles in_a_row(std::size_t count) {
  Particles particles;
  particles.resize(count);
  for (std::size_t i = 0; i < count; ++i) particles.set(i, {static_cast<double>(i), 0.0, 0.0});
  return particles;
}

TEST_CASE("independent draws come as often as their weights require (chi-square)") {
  const auto weight = uneven(101);
  ResampleParams rule{50000, 50000, {}, Scheme::kMultinomial};
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const Drawn drawn = draw_parents(in_a_row(101), weight, rule, false, 0.0, nullptr, {seed, 1});
    CHECK(drawn.parent.size() == 50000);
    const double chi = chi_square(drawn.parent, weight);  // 79 degrees: sigma 0.16
    CHECK((chi > 0.5 && chi < 1.5));
  }
}

TEST_CASE("weights of any sum are drawn as those of sum 1 are") {
  for (const double sum : {1e-9, 7.0}) {
    const auto share = uneven(101);
    auto weight = share;
    for (double& w : weight) w *= sum;
    const ResampleParams rule{20000, 20000, {}, Scheme::kMultinomial};
    const Drawn drawn = draw_parents(in_a_row(101), weight, rule, false, 0.0, nullptr, {1, 1});
    const double chi = chi_square(drawn.parent, share);
    CHECK((chi > 0.5 && chi < 1.5));
    std::vector<double> times(101);
    for (const std::size_t parent : comb(weight, 1777, 0.3)) times[parent] += 1.0;
    for (std::size_t i = 0; i < 101; ++i) CHECK(std::abs(times[i] - 1777 * share[i]) < 1.0 + 1e-9);
  }
}

TEST_CASE("the comb takes each particle as often as its weight requires, give or take one") {
  const auto weight = uneven(101);
  for (const double offset : {0.0, 0.3, 0.999999}) {
    const auto parents = comb(weight, 1777, offset);
    CHECK(parents.size() == 1777);
    std::vector<double> times(101);
    for (const std::size_t parent : parents) times[parent] += 1.0;
    for (std::size_t i = 0; i < 101; ++i) CHECK(std::abs(times[i] - 1777 * weight[i]) < 1.0 + 1e-9);
  }
}

TEST_CASE("the comb takes none without weight, not even where a tooth is an edge or the end") {
  const std::vector<double> weight{0.0, 0.5, 0.5, 0.0};
  const double almost = std::nextafter(1.0, 0.0);  // the last tooth rounds up to the sum
  for (const double offset : {0.0, almost}) {
    for (const std::size_t parent : comb(weight, 3, offset)) CHECK(weight[parent] > 0.0);
  }
  CHECK(comb(weight, 2, 0.0) == (std::vector<std::size_t>{1, 2}));
}

TEST_CASE("offsets of the comb are uniform: means over many combs are the weights") {
  const auto weight = uneven(23);
  ResampleParams rule{10, 10, {}, Scheme::kLowVariance};
  std::vector<std::size_t> all;
  for (std::uint64_t step = 0; step < 20000; ++step) {
    const Drawn drawn = draw_parents(in_a_row(23), weight, rule, false, 0.0, nullptr, {3, step});
    all.insert(all.end(), drawn.parent.begin(), drawn.parent.end());
  }
  std::vector<double> times(23);
  for (const std::size_t parent : all) times[parent] += 1.0;
  for (std::size_t i = 0; i < 23; ++i) CHECK(times[i] / 200000.0 == near(weight[i], 0.003));
}

TEST_CASE("a weight of 1 among zeros is every particle's parent, in first and last place") {
  for (const std::size_t place : {std::size_t{0}, std::size_t{9}}) {
    std::vector<double> weight(10, 0.0);
    weight[place] = 1.0;
    for (const Scheme scheme : {Scheme::kLowVariance, Scheme::kMultinomial}) {
      const ResampleParams rule{5, 50, {}, scheme};
      const Drawn drawn = draw_parents(in_a_row(10), weight, rule, false, 0.0, nullptr, {1, 1});
      for (const std::size_t parent : drawn.parent) CHECK(parent == place);
      CHECK(drawn.parent.size() == 50);  // one bucket has no information
      CHECK(draw_parents(in_a_row(10), weight, rule, true, 0.0, nullptr, {1, 1}).parent.size() ==
            5);
    }
  }
}

TEST_CASE("a bucket's place is its own: beyond all, beside pi, turned once more") {
  const auto bucket = [](double x, double y, double yaw) {
    return bucket_of({x, y, yaw}, 0.5, 0.5, 0.17);
  };
  CHECK(bucket(1e12, 0, 0) == bucket(1e11, 0, 0));
  std::vector<std::uint64_t> all;
  for (const double x : {-1e12, -0.1, 0.1, 1e12}) {
    for (const double y : {-1e12, -0.1, 0.1, 1e12}) {
      for (const double yaw : {-3.1, 0.0, 3.1}) all.push_back(bucket(x, y, yaw));
    }
  }
  std::sort(all.begin(), all.end());
  CHECK(std::adjacent_find(all.begin(), all.end()) == all.end());
  CHECK(bucket(1, 2, 3.0 + 4.0 * kPi) == bucket(1, 2, 3.0));
}

TEST_CASE("the number follows the buckets seen") {
  const std::vector<double> weight(1000, 0.001);
  for (const Scheme scheme : {Scheme::kLowVariance, Scheme::kMultinomial}) {
    Particles particles = in_a_row(1000);
    for (std::size_t i = 0; i < 1000; ++i) particles.x[i] = static_cast<double>(i % 20) + 0.25;
    const ResampleParams rule{50, 5000, {0.05, 3.0, 1.0, 1.0, 0.5}, scheme};
    const Drawn drawn = draw_parents(particles, weight, rule, false, 0.0, nullptr, {8, 1});
    CHECK(drawn.buckets == 20);
    CHECK(drawn.parent.size() == 430);  // n(20) for 0.05 and 3
  }
}

TEST_CASE("random particles are the share asked for, fill buckets and lie in free water") {
  const OccupancyGrid grid = basin();
  const FreeSpace free(grid);
  const std::vector<double> weight(100, 0.01);
  for (const Scheme scheme : {Scheme::kLowVariance, Scheme::kMultinomial}) {
    const ResampleParams rule{20000, 20000, {}, scheme};
    const Drawn drawn = draw_parents(in_a_row(100), weight, rule, false, 0.25, &free, {2, 2});
    double random = 0.0;
    for (const std::size_t parent : drawn.parent) random += parent == kRandom ? 1.0 : 0.0;
    CHECK(drawn.parent.front() != kRandom);
    CHECK(random / 20000.0 == near(0.25, 0.0125));
  }
}

TEST_CASE("draws of free water are uniform over its cells and within them") {
  OccupancyGrid grid{{3, 3, 2.0, {10.0, 20.0, 0.5 * kPi}}, std::vector<std::int8_t>(9, kOccupied)};
  for (const std::size_t i : {1U, 3U, 5U, 7U}) grid.cells[i] = kFree;
  const FreeSpace free(grid);
  std::map<int, double> times;
  double along = 0.0, square = 0.0;
  for (std::uint32_t i = 0; i < 100000; ++i) {
    const Pose2 pose = free.draw_pose({5, 5}, Purpose::kStart, i);
    const double u = (pose.y - 20.0) / 2.0;
    const double v = (10.0 - pose.x) / 2.0;
    times[static_cast<int>(v) * 3 + static_cast<int>(u)] += 1e-5;
    along += (u - std::floor(u)) * 1e-5;
    square += pose.yaw * pose.yaw * 1e-5;
  }
  CHECK(times.size() == 4);
  for (const int cell : {1, 3, 5, 7}) CHECK(times[cell] == near(0.25, 0.01));
  CHECK(along == near(0.5, 0.005));
  CHECK(square == near(kPi * kPi / 3.0, 0.05));
}

}  // namespace
