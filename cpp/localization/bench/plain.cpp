#include "plain.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <queue>
#include <unordered_set>

#include "mapperd/common/fast_math.hpp"

namespace plain {
namespace {

double range_along(const OccupancyGrid& grid, const State& s, double along_x, double along_y,
                   double max_m) {
  const GridFrame& f = grid.frame;
  const auto cell = [&](double at, double origin) {
    return static_cast<long>(std::floor((at - origin) / f.resolution_m));
  };
  const long c0 = cell(s.x, f.origin.x);
  const long r0 = cell(s.y, f.origin.y);
  const long dc = cell(s.x + max_m * along_x, f.origin.x) - c0;
  const long dr = cell(s.y + max_m * along_y, f.origin.y) - r0;
  const bool wide = std::labs(dc) >= std::labs(dr);
  const long length = wide ? std::labs(dc) : std::labs(dr);
  const long aside = wide ? std::labs(dr) : std::labs(dc);
  long c = c0, r = r0, error = 0;
  for (long k = 0; k <= length; ++k) {
    if (c < 0 || r < 0 || c >= static_cast<long>(f.columns) || r >= static_cast<long>(f.rows))
      break;
    if (!grid.is(static_cast<std::size_t>(r), static_cast<std::size_t>(c), kFree)) {
      const double cells = std::hypot(static_cast<double>(c - c0), static_cast<double>(r - r0));
      return std::min(max_m, cells * f.resolution_m);
    }
    error += aside;
    const bool step = 2 * error > length;
    if (step) error -= length;
    if (wide || step) c += dc < 0 ? -1 : 1;
    if (!wide || step) r += dr < 0 ? -1 : 1;
  }
  return max_m;
}

}  // namespace

Cloud cloud_of(const Particles& particles) {
  Cloud cloud;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    const double yaw = particles.yaw[i];
    cloud.state.push_back({particles.x[i], particles.y[i], std::cos(yaw), std::sin(yaw)});
  }
  cloud.weight.assign(particles.size(), 1.0);
  return cloud;
}

void move(Cloud& cloud, const MotionDraws& draws, std::mt19937_64& generator) {
  std::normal_distribution<double> first(draws.mean[0], draws.sigma[0]);
  std::normal_distribution<double> distance(draws.mean[1], draws.sigma[1]);
  std::normal_distribution<double> second(draws.mean[2], draws.sigma[2]);
  for (State& s : cloud.state) {
    const double heading = std::atan2(s.sine, s.cosine) + first(generator);
    const double gone = distance(generator);
    s.x += gone * std::cos(heading);
    s.y += gone * std::sin(heading);
    const double yaw = heading + second(generator);
    s.cosine = std::cos(yaw);
    s.sine = std::sin(yaw);
  }
}

void weigh_field(Cloud& cloud, const GridFrame& frame, const std::vector<float>& field,
                 double outside, const std::vector<double>& x, const std::vector<double>& y) {
  const double cosine = std::cos(frame.origin.yaw);
  const double sine = std::sin(frame.origin.yaw);
  for (std::size_t i = 0; i < cloud.state.size(); ++i) {
    const State& s = cloud.state[i];
    const double dx = s.x - frame.origin.x;
    const double dy = s.y - frame.origin.y;
    const double u0 = cosine * dx + sine * dy;
    const double v0 = cosine * dy - sine * dx;
    const double c = cosine * s.cosine + sine * s.sine;
    const double w = cosine * s.sine - sine * s.cosine;
    double sum = 1.0;
    for (std::size_t j = 0; j < x.size(); ++j) {
      const double u = c * x[j] - w * y[j] + u0;
      const double v = w * x[j] + c * y[j] + v0;
      const int column = static_cast<int>(std::floor(u / frame.resolution_m));
      const int row = static_cast<int>(std::floor(v / frame.resolution_m));
      const bool in = column >= 0 && row >= 0 && column < static_cast<int>(frame.columns) &&
                      row < static_cast<int>(frame.rows);
      const double p =
          in ? static_cast<double>(field[static_cast<std::size_t>(row) * frame.columns +
                                         static_cast<std::size_t>(column)])
             : outside;
      sum += p * p * p;
    }
    cloud.weight[i] *= sum;
  }
}

void weigh_beams(Cloud& cloud, const OccupancyGrid& grid, const BeamModel& model,
                 const std::vector<double>& x, const std::vector<double>& y) {
  for (std::size_t i = 0; i < cloud.state.size(); ++i) {
    const State& s = cloud.state[i];
    double sum = 0.0;
    for (std::size_t j = 0; j < x.size(); ++j) {
      const double range = std::hypot(x[j], y[j]);
      const double along_x = (s.cosine * x[j] - s.sine * y[j]) / range;
      const double along_y = (s.sine * x[j] + s.cosine * y[j]) / range;
      const double expected = range_along(grid, s, along_x, along_y, model.max_range_m);
      const double p = model.density(range, expected);
      sum += p * p * p;
    }
    cloud.weight[i] *= sum;
  }
}

void normalise(Cloud& cloud) {
  double sum = 0.0;
  for (const double weight : cloud.weight) sum += weight;
  for (double& weight : cloud.weight) weight /= sum;
}

void resample(Cloud& cloud, std::mt19937_64& generator) {
  std::vector<double> until;
  double sum = 0.0;
  for (const double weight : cloud.weight) until.push_back(sum += weight);
  std::uniform_real_distribution<double> place(0.0, sum);
  std::unordered_set<std::uint64_t> buckets;
  std::vector<State> drawn;
  while (drawn.size() < cloud.state.size()) {
    const auto at = std::upper_bound(until.begin(), until.end() - 1, place(generator));
    const State& s = cloud.state[static_cast<std::size_t>(at - until.begin())];
    const Pose2 pose{s.x, s.y, std::atan2(s.sine, s.cosine)};
    const auto floored = [](double value, double edge) {
      return static_cast<std::uint64_t>(static_cast<std::int64_t>(std::floor(value / edge)));
    };
    buckets.insert(floored(pose.x, 0.5) * 0x9E3779B97F4A7C15ULL ^
                   floored(pose.y, 0.5) * 0xC2B2AE3D27D4EB4FULL ^ floored(pose.yaw, 0.1745));
    drawn.push_back(s);
  }
  cloud.state.swap(drawn);
  std::fill(cloud.weight.begin(), cloud.weight.end(), 1.0);
}

std::vector<float> field_of(const OccupancyGrid& grid, const HitModel& model) {
  struct Reached {
    double squared;
    std::size_t cell, from;
    bool operator<(const Reached& other) const { return squared > other.squared; }
  };
  const std::size_t columns = grid.frame.columns;
  std::vector<float> field(grid.cells.size(), static_cast<float>(model.density(1e9)));
  std::vector<bool> seen(grid.cells.size(), false);
  std::priority_queue<Reached> open;
  const double most = std::pow(model.max_distance_m / grid.frame.resolution_m, 2);
  const auto reach = [&](std::size_t cell, std::size_t from) {
    if (seen[cell]) return;
    const double dc = static_cast<double>(cell % columns) - static_cast<double>(from % columns);
    const double dr = static_cast<double>(cell / columns) - static_cast<double>(from / columns);
    if (dc * dc + dr * dr > most) return;
    seen[cell] = true;
    open.push({dc * dc + dr * dr, cell, from});
  };
  for (std::size_t i = 0; i < grid.cells.size(); ++i) {
    if (grid.cells[i] == kOccupied) reach(i, i);
  }
  while (!open.empty()) {
    const Reached now = open.top();
    open.pop();
    field[now.cell] =
        static_cast<float>(model.density(std::sqrt(now.squared) * grid.frame.resolution_m));
    if (now.cell % columns > 0) reach(now.cell - 1, now.from);
    if (now.cell % columns + 1 < columns) reach(now.cell + 1, now.from);
    if (now.cell >= columns) reach(now.cell - columns, now.from);
    if (now.cell + columns < grid.cells.size()) reach(now.cell + columns, now.from);
  }
  return field;
}

}  // namespace plain
