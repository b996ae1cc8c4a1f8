#include "mapperd/localization/clusters.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <unordered_map>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/localization/kld.hpp"

namespace mapperd::localization {
namespace {

constexpr std::size_t kNone = static_cast<std::size_t>(-1);

struct Cell {
  double weight = 0.0;  // summed, then the mean
  std::size_t particles = 0;
  Pose2 inside;  // some pose of it
  std::size_t label = kNone;
};

struct PoseCells {
  std::vector<Cell> cell;
  std::vector<std::size_t> of_particle;
  std::unordered_map<std::uint64_t, std::size_t> place;
};

PoseCells cells_of(const Particles& p, const std::vector<double>& w, const ClusterParams& rule) {
  PoseCells cells;
  cells.place.reserve(p.size());
  for (std::size_t i = 0; i < p.size(); ++i) {
    const std::uint64_t bucket =
        bucket_of(p.pose(i), rule.bucket_xy_m, rule.bucket_xy_m, rule.bucket_yaw_rad);
    const auto found = cells.place.emplace(bucket, cells.cell.size());
    if (found.second) cells.cell.push_back({0.0, 0, p.pose(i), kNone});
    Cell& cell = cells.cell[found.first->second];
    cell.weight += w[i];
    ++cell.particles;
    cells.of_particle.push_back(found.first->second);
  }
  for (Cell& cell : cells.cell) cell.weight /= static_cast<double>(cell.particles);
  return cells;
}

void cap(std::vector<Cell>& cells, double percentile) {
  std::vector<double> weights;
  weights.reserve(cells.size());
  for (const Cell& cell : cells) weights.push_back(cell.weight);
  const auto rank = static_cast<std::size_t>(percentile * static_cast<double>(weights.size()));
  const auto at = weights.begin() + static_cast<std::ptrdiff_t>(std::min(rank, weights.size() - 1));
  std::nth_element(weights.begin(), at, weights.end());
  for (Cell& cell : cells) cell.weight = std::min(cell.weight, *at);
}

std::vector<std::size_t> by_falling_weight(const std::vector<Cell>& cells) {
  std::vector<std::size_t> order(cells.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return cells[a].weight > cells[b].weight; });
  return order;
}

// The six neighbours; headings go round.
void spread_from(PoseCells& cells, std::size_t from, const ClusterParams& rule,
                 std::vector<std::size_t>& open) {
  const Cell here = cells.cell[from];
  for (int k = 0; k < 6; ++k) {
    const double by = k % 2 == 0 ? 1.0 : -1.0;
    Pose2 pose = here.inside;
    if (k / 2 == 0) pose.x += by * rule.bucket_xy_m;
    if (k / 2 == 1) pose.y += by * rule.bucket_xy_m;
    if (k / 2 == 2) pose.yaw = wrapped(pose.yaw + by * rule.bucket_yaw_rad);
    const auto found =
        cells.place.find(bucket_of(pose, rule.bucket_xy_m, rule.bucket_xy_m, rule.bucket_yaw_rad));
    if (found == cells.place.end()) continue;
    Cell& other = cells.cell[found->second];
    if (other.label != kNone || other.weight > here.weight) continue;
    other.label = here.label;
    open.push_back(found->second);
  }
}

std::size_t label_cells(PoseCells& cells, const ClusterParams& rule) {
  std::size_t labels = 0;
  std::vector<std::size_t> open;
  for (const std::size_t start : by_falling_weight(cells.cell)) {
    if (cells.cell[start].label != kNone) continue;
    cells.cell[start].label = labels++;
    open.assign(1, start);
    while (!open.empty()) {
      const std::size_t next = open.back();
      open.pop_back();
      spread_from(cells, next, rule, open);
    }
  }
  return labels;
}

}  // namespace

Clusters clusters_of(const Particles& particles, const std::vector<double>& weight,
                     const ClusterParams& rule) {
  if (!(rule.bucket_xy_m >= 1e-3 && rule.bucket_yaw_rad >= 1e-3)) {
    throw std::invalid_argument("the clusters' buckets must be at least 0.001");
  }
  if (particles.size() == 0) return {};
  PoseCells cells = cells_of(particles, weight, rule);
  cap(cells.cell, rule.cap_percentile);
  const std::size_t labels = label_cells(cells, rule);
  std::vector<double> mass(labels);
  std::vector<std::size_t> count(labels);
  for (std::size_t i = 0; i < particles.size(); ++i) {
    const std::size_t label = cells.cell[cells.of_particle[i]].label;
    mass[label] += weight[i];
    ++count[label];
  }
  std::vector<std::size_t> order(labels);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return mass[a] > mass[b]; });
  std::vector<std::size_t> rank(labels);
  Clusters out;
  for (std::size_t k = 0; k < labels; ++k) {
    rank[order[k]] = k;
    out.mass.push_back(mass[order[k]]);
    out.particles.push_back(count[order[k]]);
  }
  for (const std::size_t cell : cells.of_particle)
    out.label.push_back(rank[cells.cell[cell].label]);
  return out;
}

Estimate best_estimate(const Particles& particles, const std::vector<double>& weight,
                       const Clusters& clusters) {
  const auto at = std::find_if(clusters.particles.begin(), clusters.particles.end(),
                               [](std::size_t count) { return count >= 2; });
  if (at == clusters.particles.end()) return estimate_of(particles, weight);
  const auto best = static_cast<std::size_t>(at - clusters.particles.begin());
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    if (clusters.label[i] == best) chosen.push_back(i);
  }
  return estimate_of(particles, weight, chosen);
}

}  // namespace mapperd::localization
