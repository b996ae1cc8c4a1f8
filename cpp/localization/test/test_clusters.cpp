// Modes of clouds of known modes.
#include <stdexcept>

#include "scenes.hpp"
#include "testing.hpp"

namespace {

using namespace scenes;

Particles of_modes(const std::vector<Pose2>& modes, std::size_t each) {
  Particles all;
  all.resize(modes.size() * each);
  for (std::size_t k = 0; k < modes.size(); ++k) {
    Particles one;
    one.resize(each);
    draw_about(modes[k], square_root_of(diagonal(0.01, 0.01, 0.002)), {9, k}, one);
    for (std::size_t i = 0; i < each; ++i) all.set(k * each + i, one.pose(i));
  }
  return all;
}

TEST_CASE("two modes: the heavier one's estimate, its mass, and not the mean between them") {
  const Particles cloud = of_modes({{0, 0, 0}, {4, 0, 0}}, 2000);
  std::vector<double> weight(4000, 0.4 / 2000);
  for (std::size_t i = 2000; i < 4000; ++i) weight[i] = 0.6 / 2000;
  const Clusters clusters = clusters_of(cloud, weight, {});
  const Estimate best = best_estimate(cloud, weight, clusters);
  CHECK(best.mean.x == near(4.0, 0.05));
  CHECK((best.mass > 0.5 && best.mass < 0.6 + 1e-9));
  CHECK(estimate_of(cloud, weight).mean.x == near(2.4, 0.05));
}

TEST_CASE("headings beside pi are one mode") {
  const Particles cloud = of_modes({{0, 0, kPi}}, 1000);
  const Clusters clusters = clusters_of(cloud, std::vector<double>(1000, 1e-3), {0.5, 0.524, 0.9});
  CHECK(clusters.mass.front() > 0.95);
}

TEST_CASE("masses sum to 1, fall, and belong to the labels") {
  const Particles cloud = of_modes({{0, 0, 0}, {4, 0, 0}, {0, 4, 2}, {4, 4, -2}}, 300);
  std::vector<double> weight;
  for (std::size_t i = 0; i < 1200; ++i)
    weight.push_back((1.0 + static_cast<double>(i / 300)) / 3000);
  const Clusters clusters = clusters_of(cloud, weight, {});
  std::vector<double> mass(clusters.mass.size());
  for (std::size_t i = 0; i < 1200; ++i) mass[clusters.label[i]] += weight[i];
  double sum = 0.0;
  for (std::size_t k = 0; k < mass.size(); ++k) {
    CHECK(mass[k] == near(clusters.mass[k], 1e-12));
    CHECK((k == 0 || clusters.mass[k] <= clusters.mass[k - 1]));
    sum += mass[k];
  }
  CHECK(sum == near(1.0, 1e-9));
}

// Cells in a row along x: so many particles in each, of so much weight each.
struct Row {
  Particles cloud;
  std::vector<double> weight;

  void add(double x, double yaw, std::size_t count, double each) {
    const std::size_t first = cloud.size();
    cloud.resize(first + count);
    for (std::size_t i = first; i < cloud.size(); ++i) cloud.set(i, {x, 0.25, yaw});
    weight.resize(cloud.size(), each);
  }
  std::size_t modes(double percentile) const {
    return clusters_of(cloud, weight, {0.5, 0.524, percentile}).mass.size();
  }
};

TEST_CASE("modes are parted by valleys of the mean weight, cut at a percentile") {
  Row valley;
  valley.add(0.25, 0, 2, 0.5);
  valley.add(0.75, 0, 2, 0.1);
  valley.add(1.25, 0, 2, 0.4);
  CHECK(valley.modes(0.9) == 2);
  CHECK(valley.modes(1.0) == 2);
  CHECK(valley.modes(0.0) == 1);
  Row hill;
  hill.add(0.25, 0, 2, 0.1);
  hill.add(0.75, 0, 2, 0.5);
  hill.add(1.25, 0, 2, 0.2);
  CHECK(hill.modes(0.9) == 1);
  Row crowd;  // many light particles weigh much together, and are no peak
  crowd.add(0.25, 0, 1, 0.3);
  crowd.add(0.75, 0, 1, 0.1);
  crowd.add(1.25, 0, 10, 0.02);
  CHECK(crowd.modes(0.9) == 1);
  Row seam;
  seam.add(0.25, 3.0, 2, 0.3);
  seam.add(0.25, -3.0, 2, 0.2);
  CHECK(seam.modes(0.9) == 1);
  CHECK_THROWS_AS(clusters_of(seam.cloud, seam.weight, {0.0, 0.5, 0.9}), std::invalid_argument);
  CHECK_THROWS_AS(clusters_of(seam.cloud, seam.weight, {0.5, 0.0, 0.9}), std::invalid_argument);
}

TEST_CASE("a heavy particle alone is no mode") {
  Row row;
  row.add(0.25, 0, 1, 0.6);
  row.add(5.25, 0, 2, 0.2);
  const Estimate best =
      best_estimate(row.cloud, row.weight, clusters_of(row.cloud, row.weight, {0.5, 0.524, 0.9}));
  CHECK(best.particles == 2);
  CHECK(best.mean.x == near(5.25, 1e-12));
}

TEST_CASE("single particles: the estimate is that of all") {
  const Particles cloud = of_modes({{0, 0, 0}, {9, 0, 0}, {0, 9, 2}}, 1);
  const std::vector<double> weight{0.2, 0.3, 0.5};
  const Estimate best = best_estimate(cloud, weight, clusters_of(cloud, weight, {}));
  CHECK(best.particles == 3);
  CHECK(clusters_of({}, {}, {}).mass.empty());
}

}  // namespace
