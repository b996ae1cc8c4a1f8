// Pings over a hundred voxels and more, with ragged first returns; and what a voxel gives on its
// own, without any walk, verdict or shortcut.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "mapperd/map/fan.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/voxel_integral.hpp"
#include "oracle.hpp"
#include "scenes.hpp"

namespace scenes {

struct Ragged {
  std::size_t rows = 300;
  std::size_t beams = 128;
  double half_fan_rad = 0.6;
  double surface = 0.6;     // where the first returns lie, as a part of the range ...
  double jump = 0.2;        // ... and how much neighbouring beams differ
  double silent = 0.1;      // share of the beams without a return
  int thickness = 1;        // rows after the first return, half of them with one
  double nearer = 0.0;      // share of beams with a stray return anywhere before
  double max_range_m = 20;  // of the ping
};

inline Ping ragged_ping(const Ragged& want, Random& random) {
  Ping ping = empty_ping(want.rows, want.beams, want.half_fan_rad, want.max_range_m);
  const auto rows = static_cast<double>(want.rows);
  const auto mark = [&](double row, std::size_t beam) {
    if (row < 0 || row >= rows) return;
    const auto k = static_cast<std::size_t>(row);
    ping.intensity[k * want.beams + beam] = static_cast<float>(random.uniform(36, 255));
  };
  const double phase = random.uniform(0, 6);
  for (std::size_t j = 0; j < want.beams; ++j) {
    if (random.uniform(0, 1) < want.silent) continue;
    const double slope =
        0.1 * std::sin(phase + 9.0 * static_cast<double>(j) / static_cast<double>(want.beams));
    // Speckle: most beams stay near the surface, some begin much earlier or later.
    const double spread = want.jump * random.uniform(-1, 1) * random.uniform(0, 1);
    const double first = rows * (want.surface + slope + spread);
    mark(first, j);
    for (int k = 1; k < want.thickness; ++k) {
      if (random.uniform(0, 1) < 0.5) mark(first + k, j);
    }
    if (random.uniform(0, 1) < want.nearer) mark(random.uniform(0, first), j);
  }
  return ping;
}

// A point near one of the places where classes change: first returns, shadows behind them, the
// aperture's cones, the fan's sides; or just anywhere in the fan.
class Borders {
 public:
  Borders(const Ping& ping, const mapperd::map::FanSettings& settings, double edge_m)
      : ping_(ping),
        half_aperture_(settings.vertical_aperture_rad / 2),
        edge_m_(edge_m),
        edges_(mapperd::map::beam_edges(ping.bearings_rad.data(), ping.bearings_rad.size())) {}

  mapperd::Vec3 point(Random& random) const {  // in the sonar's frame
    const double reach = ping_.image().max_range_m();
    const auto last = static_cast<int>(ping_.bearings_rad.size()) - 1;
    const auto beam = static_cast<std::size_t>(random.integer(0, last));
    const double first = first_return_m(beam);
    double range = reach * std::cbrt(random.uniform(0, 1));
    double bearing = random.uniform(edges_.front(), edges_.back());
    double elevation = random.uniform(-half_aperture_, half_aperture_);
    const int kind = random.integer(0, 9);
    if (kind < 3) range = first + random.uniform(-2.5, 2.5) * edge_m_;
    if (kind >= 3 && kind < 6) range = random.uniform(first, reach);
    const double voxel_rad = edge_m_ / std::max(range, edge_m_);
    if (kind < 6) bearing = edges_[beam] + random.uniform(-1.5, 1.5) * voxel_rad;
    const double beside = random.uniform(-1.5, 1.5) * voxel_rad;
    if (kind == 6 || kind == 5) elevation = std::copysign(half_aperture_, elevation) + beside;
    if (kind == 7) bearing = (elevation > 0 ? edges_.front() : edges_.back()) + beside;
    // Near the sonar, where the fan is thinner than a voxel.
    if (kind == 8) range = reach * std::pow(random.uniform(0, 1), 4);
    return mapperd::map::fan_point(range, bearing, elevation);
  }

  // Where a beam with a return ends, and its neighbour begins: voxels that both of these cut.
  mapperd::Vec3 corner(Random& random) const {
    const auto last = static_cast<int>(ping_.bearings_rad.size()) - 1;
    std::size_t beam = 0;
    do {
      beam = static_cast<std::size_t>(random.integer(0, last));
    } while (!(first_return_m(beam) < ping_.image().max_range_m()));
    const double range = first_return_m(beam) + random.uniform(-1, 1) * edge_m_;
    const double edge = edges_[beam + static_cast<std::size_t>(random.integer(0, 1))];
    const double beside = random.uniform(-0.5, 0.5) * edge_m_ / std::max(range, edge_m_);
    return mapperd::map::fan_point(range, edge + beside, random.uniform(-0.8, 0.8) * half_aperture_);
  }

 private:
  double first_return_m(std::size_t beam) const {
    for (std::size_t k = 0; k < ping_.rows; ++k) {
      if (ping_.intensity[k * ping_.bearings_rad.size() + beam] > 35) {
        return static_cast<double>(k) * ping_.range_resolution_m;
      }
    }
    return ping_.image().max_range_m();
  }

  const Ping& ping_;
  double half_aperture_;
  double edge_m_;
  std::vector<double> edges_;
};

// The closed form over one voxel, all beams and rows that its circumscribed ball meets.
inline oracle::Parts parts_on_its_own(const mapperd::map::Fan& fan, const mapperd::Vec3& place,
                                      double edge_m) {
  const mapperd::map::Seen seen =
      fan.view() == nullptr ? mapperd::map::Seen{place, {}} : fan.view()->look(place);
  const mapperd::Vec3& centre = seen.at;
  const double radius = (fan.view() == nullptr ? 0.867 : 1.2) * edge_m;
  const mapperd::Vec3 at = fan.to_sonar(centre);
  const double horizontal = std::hypot(at.x, at.y);
  const double range = mapperd::norm(at);
  mapperd::map::FanPart where{0, fan.beams() - 1, std::max(range - radius, 0.0), range + radius, true};
  if (horizontal > 1.01 * radius) {
    const double bearing = std::atan2(-at.y, at.x);
    const double half = std::asin(radius / horizontal);
    const auto& edges = fan.edges_rad();
    const auto from = std::upper_bound(edges.begin(), edges.end(), bearing - half);
    const auto to = std::upper_bound(edges.begin(), edges.end(), bearing + half);
    if (from == edges.end() || to == edges.begin()) return {};
    where.first_beam =
        static_cast<std::size_t>(std::max<std::ptrdiff_t>(from - edges.begin(), 1) - 1);
    where.last_beam = std::min(static_cast<std::size_t>(to - edges.begin()), fan.beams()) - 1;
  }
  const mapperd::map::Cube cube{
      {centre.x, centre.y, centre.z}, edge_m / 2, fan.view() == nullptr ? nullptr : &seen.axes};
  const mapperd::map::Two occupied = mapperd::map::occupied_part(fan, cube, where);
  return {occupied.part, mapperd::map::free_part(fan, cube, where), occupied.weight};
}

}  // namespace scenes
