// Evidence along lines through a voxel, against the closed form: the error falls as documented.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <vector>

#include "check.hpp"
#include "far_scenes.hpp"
#include "mapperd/map/voxel_lines.hpp"

namespace {

using mapperd::map::Fan;
using mapperd::Vec3;
using mapperd::map::VoxelLines;
using oracle::Parts;

// As in block_evidence.cpp, where the number of lines is chosen by it.
constexpr double kSpread = 3.0;

// The ping whose weights are the squares of this one's, by a steeper rule: its closed form gives
// the integral of the squared weight.
mapperd::map::IwloParams steep() {
  mapperd::map::IwloParams params;
  params.sharpness = 20;
  return params;
}

scenes::Ping squared(scenes::Ping ping) {
  const mapperd::map::IwloParams params;
  const mapperd::map::IwloRule rule(params);
  const double span = params.intensity_max - params.intensity_threshold;
  for (float& intensity : ping.intensity) {
    if (!rule.is_return(intensity)) continue;
    const double w = rule.occupied_weight(intensity) * rule.occupied_weight(intensity);
    const double x = 0.5 + std::log(w / (1 - w)) / steep().sharpness;
    intensity = static_cast<float>(params.intensity_threshold + x * span);
  }
  return ping;
}

// How much the weights inside a voxel differ.
double sigma_of(const Parts& own, const Parts& of_squares) {
  return std::sqrt(std::max(of_squares.weight() - own.weight() * own.weight(), 0.0));
}

struct Errors {
  std::vector<double> parts;   // error of the parts, times the lines
  std::vector<double> weight;  // of the mean weight, over what is documented
  std::vector<double> sides;   // as `parts`, of voxels that the fan's sides or aperture cut
};

void add(const VoxelLines::Sample& sample, const Parts& own, double sigma, int lines, bool cut,
         Errors& errors) {
  const double part_error =
      std::max(std::abs(sample.sum.occupied - own.occupied), std::abs(sample.sum.free - own.free));
  errors.parts.push_back(part_error * lines);
  if (cut) errors.sides.push_back(part_error * lines);
  if (own.occupied < 0.02 || sample.sum.occupied <= 0) return;
  const double documented = kSpread * sigma / (lines * std::sqrt(own.occupied));
  // The sum is in single precision.
  errors.weight.push_back(std::abs(sample.sum.weight() - own.weight()) / (documented + 1e-4));
}

constexpr std::array<int, 5> kLines{8, 16, 32, 64, 128};
using AllErrors = std::array<Errors, kLines.size()>;

void add_voxel(const Fan& fan, const Fan& of_squares, const VoxelLines& voxel_lines,
               const Vec3& centre, double edge_m, AllErrors& errors) {
  const Fan::Verdict verdict = fan.verdict(centre, edge_m);
  if (verdict.content != Fan::Content::undecided || mapperd::norm(centre) < 10 * edge_m) return;
  const mapperd::map::Cube cube{{centre.x, centre.y, centre.z}, edge_m / 2};
  mapperd::map::LineTask task;
  if (!voxel_lines.prepare(cube, verdict.where, task)) return;
  const Parts own = scenes::parts_on_its_own(fan, centre, edge_m);
  const double sigma = own.occupied < 0.02
                           ? 0.0
                           : sigma_of(own, scenes::parts_on_its_own(of_squares, centre, edge_m));
  const bool cut = verdict.where.cut_by_aperture || verdict.where.cut_by_sides;
  for (std::size_t i = 0; i < kLines.size(); ++i) {
    const VoxelLines::Sample sample = voxel_lines.sample(task, kLines[i]);
    add(sample, own, sigma, kLines[i], cut, errors[i]);
  }
}

struct Scene {
  scenes::Ping ping;
  mapperd::map::FanSettings settings;
  double edge_m;
};

// 30 to 200 voxels of range, everything at random, thin apertures and narrow fans included.
Scene any_scene(scenes::Random& random) {
  scenes::Ragged want;
  want.rows = static_cast<std::size_t>(random.integer(100, 600));
  want.beams = static_cast<std::size_t>(random.integer(16, 300));
  want.thickness = random.integer(1, 30);
  want.nearer = 0.5;
  want.half_fan_rad = random.uniform(0, 1) < 0.3 ? 0.05 : random.uniform(0.3, 1.1);
  Scene scene{scenes::ragged_ping(want, random), {}, want.max_range_m / random.uniform(30, 200)};
  scene.settings.vertical_aperture_rad = random.uniform(0.01, 0.4);
  scene.settings.carve_no_return = random.uniform(0, 1) < 0.5;
  scene.settings.min_range_m = random.uniform(0, 10);
  return scene;
}

// As a sonar sees it far away.
Scene usual_scene(scenes::Random& random) {
  scenes::Ragged want;
  want.rows = static_cast<std::size_t>(random.integer(200, 600));
  want.beams = static_cast<std::size_t>(random.integer(64, 512));
  want.thickness = random.integer(1, 30);
  want.half_fan_rad = random.uniform(0.5, 1.1);
  Scene scene{scenes::ragged_ping(want, random), {}, want.max_range_m / random.uniform(100, 200)};
  scene.settings.vertical_aperture_rad = random.uniform(0.2, 0.4);
  return scene;
}

// At the borders between classes; or else anywhere in the fan, no place rather than another.
AllErrors errors_of(Scene (*next_scene)(scenes::Random&), bool at_borders) {
  AllErrors errors;
  for (int i = 0; i < (check::sanitized() ? 3 : 12); ++i) {
    scenes::Random random(300 + static_cast<std::uint64_t>(i));
    const Scene scene = next_scene(random);
    const scenes::Ping& ping = scene.ping;
    const scenes::Ping squares = squared(ping);
    const mapperd::Transform pose = scenes::random_pose(random);
    const Fan fan(ping.image(), scene.settings, mapperd::map::IwloRule{{}}, pose);
    const Fan of_squares(squares.image(), scene.settings, mapperd::map::IwloRule{steep()}, pose);
    const VoxelLines voxel_lines(fan, scene.edge_m, mapperd::map::kernels());
    const scenes::Borders borders(ping, scene.settings, scene.edge_m);
    const double half_aperture = scene.settings.vertical_aperture_rad / 2;
    for (int k = 0; k < (check::sanitized() ? 100 : 1000) * (at_borders ? 1 : 4); ++k) {
      const double range = fan.max_range_m() * std::cbrt(random.uniform(0, 1));
      const double bearing = random.uniform(fan.edges_rad().front(), fan.edges_rad().back());
      const double elevation = random.uniform(-half_aperture, half_aperture);
      const Vec3 anywhere = mapperd::map::fan_point(range, bearing, elevation);
      const Vec3 point = at_borders ? borders.point(random) : anywhere;
      add_voxel(fan, of_squares, voxel_lines, fan.to_map(point), scene.edge_m, errors);
    }
  }
  return errors;
}

// What `share` of the values lie below.
double at_share(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

void print(int lines, const char* what, const std::vector<double>& values) {
  std::printf("  %3d lines, %4zu %s: %.2f in 90 %%, %.2f in 99 %%, %.2f at worst\n", lines,
              values.size(), what, at_share(values, 0.9), at_share(values, 0.99),
              at_share(values, 1.0));
}

TEST_CASE("parts along lines are near to the closed form, the nearer the more lines") {
  const AllErrors all = errors_of(any_scene, true);
  for (std::size_t i = 0; i < kLines.size(); ++i) {
    const Errors& errors = all[i];
    print(kLines[i], "voxels, error times lines", errors.parts);
    print(kLines[i], "of them cut", errors.sides);
    print(kLines[i], "weights, error over documented", errors.weight);
    if (check::sanitized()) continue;  // too few to be shares of
    CHECK(errors.parts.size() > 300 && errors.sides.size() > 50);
    CHECK(at_share(errors.parts, 0.9) <= 1.0 && at_share(errors.sides, 0.9) <= 1.0);
    CHECK(at_share(errors.parts, 0.99) <= 3.5 && at_share(errors.sides, 0.99) <= 3.5);
    // Two planes nearly along the lines and askew to the lattice: a step of it each.
    CHECK(at_share(errors.parts, 1.0) <= 1.25 * std::sqrt(kLines[i]));
  }
}

TEST_CASE("weights along lines are as near to the closed form as documented") {
  const AllErrors all = errors_of(usual_scene, false);
  for (std::size_t i = 0; i < kLines.size(); ++i) {
    print(kLines[i], "weights, error over documented", all[i].weight);
    if (check::sanitized()) continue;  // too few to be shares of
    CHECK(all[i].weight.size() > 100);
    CHECK(at_share(all[i].weight, 0.99) <= 1.0);
  }
}

// No plane cuts these, and lines run along the range: what is left is the series for range along
// them.
TEST_CASE("rings that are alike in all beams lose next to nothing along the axes") {
  scenes::Random random(320);
  scenes::Ping ping = scenes::empty_ping(60, 8, 1.0, 20.0);
  for (std::size_t i = 0; i < ping.intensity.size(); ++i) {
    ping.intensity[i] = i / 8 % 2 == 0 ? 0.0F : 60.0F + static_cast<float>(i / 8);
  }
  mapperd::map::FanSettings settings;
  settings.vertical_aperture_rad = 1.4;
  double worst = 0.0;
  for (int i = 0; i < 40; ++i) {
    const mapperd::Transform pose = scenes::rotation_zyx(1.5707963267948966 * i, 0.01, 0.01);
    const Fan fan(ping.image(), settings, mapperd::map::IwloRule{{}}, pose);
    const VoxelLines voxel_lines(fan, 0.5, mapperd::map::kernels());
    for (int k = 0; k < 10; ++k) {
      const Vec3 centre = fan.to_map(mapperd::map::fan_point(
          random.uniform(5.0, 9.0), random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1)));
      const Fan::Verdict verdict = fan.verdict(centre, 0.5);
      const mapperd::map::Cube cube{{centre.x, centre.y, centre.z}, 0.25};
      mapperd::map::LineTask task;
      CHECK(voxel_lines.prepare(cube, verdict.where, task));
      const VoxelLines::Sample sample = voxel_lines.sample(task, 128);
      const Parts own = scenes::parts_on_its_own(fan, centre, 0.5);
      worst = std::max(worst, std::abs(sample.sum.occupied - own.occupied));
    }
  }
  std::printf("  %.1e at worst\n", worst);
  CHECK(worst < 6e-4);
}

}  // namespace
