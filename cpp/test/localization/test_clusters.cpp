// Modes of clouds of known modes.
#include "check.hpp"
#include "scenes.hpp"

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
  CHECK_NEAR(best.mean.x, 4.0, 0.05);
  CHECK(best.mass > 0.5 && best.mass < 0.6 + 1e-9);
  CHECK_NEAR(estimate_of(cloud, weight).mean.x, 2.4, 0.05);
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
    CHECK_NEAR(mass[k], clusters.mass[k], 1e-12);
    CHECK(k == 0 || clusters.mass[k] <= clusters.mass[k - 1]);
    sum += mass[k];
  }
  CHECK_NEAR(sum, 1.0, 1e-9);
}

TEST_CASE("single particles: the estimate is that of all") {
  const Particles cloud = of_modes({{0, 0, 0}, {9, 0, 0}, {0, 9, 2}}, 1);
  const std::vector<double> weight{0.2, 0.3, 0.5};
  const Estimate best = best_estimate(cloud, weight, clusters_of(cloud, weight, {}));
  CHECK(best.particles == 3);
  CHECK(clusters_of({}, {}, {}).mass.empty());
}

}  // namespace
