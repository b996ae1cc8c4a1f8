// The evidence grid and its integrator against the oracle.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>
#include <unordered_map>
#include <vector>

#include "mapperd/map/evidence_grid.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "oracle.hpp"
#include "oracle_motion.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::Aggregation;
using mapperd::map::CellPoints;
using mapperd::map::EvidenceGrid;
using mapperd::map::PingMotion;
using mapperd::map::VoxelIndex;
using mapperd::map::VoxelMap;
using mapperd::map::VoxelState;
using oracle::Class;
using oracle::Evidence;
using oracle::Measure;
using oracle::PingOracle;

enum class Table { kEvenSine, kEvenAngle, kIrregular };

struct Scene {
  std::string name;
  Table table = Table::kEvenSine;
  scenes::Ping ping;
  oracle::Settings settings;
  Transform pose;
  PingMotion motion;
  mapperd::map::BlockBox limit;

  Measure measure() const { return table == Table::kEvenSine ? Measure::kSine : Measure::kBeams; }
};

void lay_bearings(Table table, double half_fan, scenes::Random& random, std::vector<double>& b) {
  const auto beams = static_cast<double>(b.size());
  for (std::size_t j = 0; j < b.size(); ++j) {
    const double place = 2 * (static_cast<double>(j) + 0.5) / beams - 1;
    if (table == Table::kEvenSine) b[j] = std::asin(std::sin(half_fan) * place);
    if (table == Table::kEvenAngle) b[j] = half_fan * place;
    if (table == Table::kIrregular) b[j] = half_fan * (place + random.uniform(-0.6, 0.6) / beams);
  }
}

Scene scene_of(std::uint64_t seed) {
  scenes::Random random(seed);
  Scene scene;
  scene.table = static_cast<Table>(seed % 3);
  scenes::Ragged want;
  const int beams[] = {2, 3, 7, 8, 16, 21, 40, 64, 90, 130, 200, 300};
  want.beams = static_cast<std::size_t>(beams[random.integer(0, 11)]);
  want.rows = static_cast<std::size_t>(random.integer(30, 200));
  want.half_fan_rad = seed % 11 == 3 ? random.uniform(0.02, 0.1) : random.uniform(0.1, 1.2);
  want.max_range_m = random.uniform(1.5, 20);
  want.surface = random.uniform(0.2, 0.9);
  want.jump = random.uniform(0, 0.4);
  want.silent = random.uniform(0, 0.4);
  want.thickness = random.integer(1, 12);
  want.nearer = random.uniform(0, seed % 11 == 3 ? 1.0 : 0.3);
  scene.ping = scenes::ragged_ping(want, random);
  lay_bearings(scene.table, want.half_fan_rad, random, scene.ping.bearings_rad);
  oracle::Settings& settings = scene.settings;
  settings.edge_m = want.max_range_m / random.uniform(8, seed % 4 == 0 ? 45 : 28);
  settings.ping.vertical_aperture_rad =
      random.uniform(0, 1) < 0.3 ? random.uniform(0.02, 0.1) : random.uniform(0.1, 1.2);
  const double row_m = scene.ping.range_resolution_m;
  settings.ping.min_range_m = seed % 5 == 0 ? 0.0 : random.uniform(0, 0.4) * want.max_range_m;
  if (seed % 5 == 1) settings.ping.min_range_m = 0.5 * row_m;
  settings.ping.carve_no_return = random.integer(0, 2) == 0;
  if (seed % 6 == 5) settings.ping.aggregation = Aggregation::kMean;
  settings.ping.detail = seed % 7 == 0 ? 0.5 : seed % 7 == 1 ? 2.0 : 1.0;
  settings.iwlo.sharpness = random.uniform(0.1, 5.0);
  settings.ping.threads = seed % 4 == 3 ? 2 : 1;
  scene.pose = scenes::random_pose(random);
  if (seed % 8 == 1) scene.pose = scenes::rotation_zyx(0, 0, 0);
  if (seed % 8 == 2) scene.pose = scenes::rotation_zyx(0, 1.5707963267948966, 0);
  if (seed % 8 == 3) scene.pose.translation = {1e6 + 0.3, -1e6, 1e5};
  if (seed % 3 == 1 && seed % 2 == 0) {
    scene.motion = scenes::motion_of(random.uniform(0, 3), random.uniform(0, 1), random,
                                     seed % 4 == 0 ? 1500 : 300);
  }
  if (seed % 9 == 4) {
    const double block_m = 16 * settings.edge_m;
    scene.limit.first.x = static_cast<int>(std::floor(scene.pose.translation.x / block_m));
    scene.limit.last.z = static_cast<int>(std::floor(scene.pose.translation.z / block_m));
  }
  const char* const tables[] = {"sine", "angle", "irregular"};
  scene.name = "scene " + std::to_string(seed) + " (" + tables[seed % 3] + ", " +
               std::to_string(want.beams) + " beams)";
  return scene;
}

// Nodes of a scene's grid, each judged once.
class Nodes {
 public:
  explicit Nodes(const Scene& scene)
      : oracle(scene.ping.image(), scene.settings, scene.measure()),
        scene_(scene),
        rule_(scene.settings.iwlo),
        grid_(memory_, scene.ping.image(), scene.settings.ping, rule_, scene.settings.edge_m) {}

  PingOracle oracle;

  const EvidenceGrid& grid() const { return grid_; }
  double row_of(double range_m) const { return range_m / grid_.row_pitch_m(); }
  double column_of(double sine) const { return oracle.place_of(sine) * grid_.subcolumns(); }
  double range_of(std::int64_t row) const {
    return (static_cast<double>(row) + 0.5) * grid_.row_pitch_m();
  }
  double sine_of(std::int64_t column) const {
    return oracle.sine_at((static_cast<double>(column) + 0.5) / grid_.subcolumns());
  }

  const Evidence& at(std::int64_t row, std::int64_t column) {
    const std::int64_t key = row * 100000000 + column;
    const auto found = known_.find(key);
    if (found != known_.end()) return found->second;
    return known_[key] = is_beside(column) ? Evidence{} : oracle.at(range_of(row), sine_of(column));
  }

  // From eight beams beside the fan on, its beams made a multiple of eight, there is no evidence.
  bool is_beside(std::int64_t column) const {
    const std::size_t beams = scene_.ping.bearings_rad.size();
    const std::int64_t margin = 8 * grid_.subcolumns();
    const auto end = static_cast<std::int64_t>((beams + 7) / 8 * 8) * grid_.subcolumns();
    return column <= -margin || column >= end + margin - 1;
  }

  // The grid adds up rows and columns in single precision: each sum, of all rows or columns before,
  // is off by a few 2^-24 of it, and a footprint is a few of them.
  double tolerance(double range_m, double sine) const {
    const mapperd::map::PingImage image = scene_.ping.image();
    const double depth = 1.08 * scene_.settings.edge_m / image.range_resolution_m;
    const auto beams = static_cast<double>(image.beams);
    const double width = std::min(2 * oracle.half_width(range_m, sine), beams);
    return 1e-5 + 0x1p-22 * (static_cast<double>(image.rows) / depth + beams / width);
  }

  // Whether a voxel's new state is what this evidence makes of it.
  bool makes(const Evidence& e, double tolerance, const VoxelState& state) const {
    const bool may_be_occupied = e.returns >= 0.02 - tolerance;
    const bool may_be_other = e.returns < 0.02 + tolerance;
    if (state.count == 0) return may_be_other && e.free <= 0.5 + tolerance;
    oracle::State free;
    oracle::update(free, {0, 1, 0}, scene_.settings);
    const double unit = rule_.unit();
    if (may_be_other && e.free > 0.5 - tolerance &&
        std::abs(state.log_odds - free.log_odds) <= unit)
      return true;
    if (!may_be_occupied) return false;
    oracle::State occupied;
    const double lift = std::max(0.0201 - e.returns, 0.0) / 0.02;  // over the limit
    oracle::update(occupied, {e.returns + lift * e.returns, e.free, e.weighted + lift * e.weighted},
                   scene_.settings);
    // Half a code of 253, three roundings to units, and what the sums are off by.
    const double L_occ = scene_.settings.iwlo.L_occ;
    const double range_of_weights = rule_.largest_weight() - rule_.min_weight();
    double off = L_occ * (0.5 / 253 * range_of_weights + 2 * tolerance / e.returns) + 3 * unit;
    if (scene_.settings.ping.aggregation == Aggregation::kMean) {
      // Half a share of 255.
      const double all = L_occ - scene_.settings.iwlo.L_free;
      off += all * (0.5 / 255 + 2 * tolerance / (e.returns + e.free)) + unit;
    }
    return std::abs(state.log_odds - occupied.log_odds) <= off;
  }

 private:
  const Scene& scene_;
  mapperd::map::IwloRule rule_;
  mapperd::map::GridMemory memory_;
  EvidenceGrid grid_;
  std::unordered_map<std::int64_t, Evidence> known_;
};

int scene_count(int released) { return kSanitized ? 2 : released; }

TEST_CASE("the grid holds the definition's values at its nodes") {
  int compared = 0, occupied = 0, free = 0, off = 0;
  for (int seed = 0; seed < scene_count(200); ++seed) {
    const Scene scene = scene_of(static_cast<std::uint64_t>(seed));
    Nodes nodes(scene);
    const EvidenceGrid& grid = nodes.grid();
    if (grid.is_empty()) continue;
    scenes::Random random(static_cast<std::uint64_t>(seed) + 9000);
    const mapperd::map::IwloRule rule(scene.settings.iwlo);
    const auto beams = static_cast<int>(scene.ping.bearings_rad.size());
    int wrong = 0;
    for (int i = 0; i < 3000; ++i) {
      const double part = random.uniform(0, 1);
      const double range = grid.reach_m() * 1.05 * (i % 3 == 0 ? part * part * part : part);
      const auto row = static_cast<std::int64_t>(nodes.row_of(range));
      const double at_m = nodes.range_of(row);
      // Beside the fan, too, as far as footprints reach.
      const auto beside = static_cast<int>(
          std::min(40 + 1.2 * nodes.oracle.half_width(at_m, 0.0) * grid.subcolumns(), 1e6));
      const std::int64_t column = random.integer(-beside, beams * grid.subcolumns() + beside - 1);
      const double sine = nodes.sine_of(column);
      if (!(std::abs(sine) < 0.9999)) continue;
      const EvidenceGrid::Evidence is =
          grid.at({at_m * std::sqrt(1 - sine * sine), -at_m * sine, 0.0});
      const Evidence& e = nodes.at(row, column);
      ++compared;
      VoxelState state;
      if (is.code == mapperd::map::kCodeFree) {
        state = {static_cast<float>(rule.free_step(0, 0)), 1};
      } else if (is.code >= mapperd::map::kCodeOccupied) {
        double step = rule.log_odds(rule.full_step_of_code(is.code));
        if (grid.averages())
          step = (is.share * step + (255 - is.share) * rule.free_step(0, 0)) / 255;
        state = {static_cast<float>(step), 1};
      }
      occupied += is.code >= mapperd::map::kCodeOccupied ? 1 : 0;
      free += is.code == mapperd::map::kCodeFree ? 1 : 0;
      if (nodes.makes(e, nodes.tolerance(at_m, sine), state)) continue;
      ++wrong;
      if (wrong <= 2) {
        std::printf(
            "  %s: row %d column %d of %d, range %.2f edges, half %.1f beams: code %d, N %.5f F "
            "%.5f w %.4f\n",
            scene.name.c_str(), static_cast<int>(row), static_cast<int>(column),
            beams * grid.subcolumns(), at_m / scene.settings.edge_m,
            nodes.oracle.half_width(at_m, sine), is.code, e.returns, e.free, e.weight());
      }
    }
    off += wrong;
    CHECK(wrong == 0);
  }
  std::printf("  %d nodes, %d occupied, %d free, %d off\n", compared, occupied, free, off);
  CHECK((kSanitized || (occupied > 10000 && free > 10000)));
}

TEST_CASE("points looked up together have the evidence of each alone") {
  int with_evidence = 0;
  for (int seed = 0; seed < scene_count(60); ++seed) {
    const Scene scene = scene_of(static_cast<std::uint64_t>(seed));
    const Nodes nodes(scene);
    const EvidenceGrid& grid = nodes.grid();
    if (grid.is_empty()) continue;
    scenes::Random random(static_cast<std::uint64_t>(seed) + 9500);
    const double reach_m = 1.1 * grid.reach_m();
    CellPoints points;
    for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
      points.set(i, random.uniform(0, 1) * reach_m * scenes::random_direction(random));
      points.x[i] = std::abs(points.x[i]) - 0.1 * grid.edge_m();
      points.z[i] *= random.uniform(0, grid.sin_half_aperture());
    }
    points.set(7, {});
    std::array<std::uint8_t, CellPoints::kCount> codes, shares;
    const mapperd::map::CodeCounts found = grid.at(points, codes.data(), shares.data());
    int occupied = 0, free = 0;
    for (std::size_t i = 0; i < CellPoints::kCount; ++i) {
      const EvidenceGrid::Evidence alone = grid.at(points.at(i));
      CHECK((codes[i] == alone.code && shares[i] == alone.share));
      occupied += alone.code >= mapperd::map::kCodeOccupied ? 1 : 0;
      free += alone.code == mapperd::map::kCodeFree ? 1 : 0;
    }
    CHECK((found.occupied == occupied && found.free == free));
    with_evidence += occupied + free;
  }
  CHECK((kSanitized || with_evidence > 500));
}

// One ping into an empty map, voxel by voxel.
class Comparison {
 public:
  explicit Comparison(const Scene& scene) : Comparison(scene, scene.motion) {}
  // With a motion passed to the integrator.
  Comparison(const Scene& scene, const PingMotion& assumed)
      : scene_(scene),
        nodes_(scene),
        map_(scene.settings.edge_m, scene.settings.iwlo),
        track_(scene.pose, scene.motion),
        start_(track_.at(0)) {
    map_.limit_to(scene.limit);
    integrate_evidence_grid(map_, scene.ping.image(), scene.pose, scene.settings.ping, assumed);
  }

  int compared = 0;
  int occupied = 0;
  int wrong = 0;        // of no node nearby
  int other_class = 0;  // than at the voxel's own centre
  int other_volume = 0;
  int every = 1;  // looks at one voxel of so many
  bool by_volume = false;
  bool quiet = false;

  void run() {
    const Vec3& at = start_.translation;
    const double reach = 1.03 * scene_.ping.image().max_range_m() + 2 * map_.resolution_m();
    VoxelIndex low, high;
    CHECK(map_.index_of(at - Vec3{reach, reach, reach}, low));
    CHECK(map_.index_of(at + Vec3{reach, reach, reach}, high));
    for (VoxelIndex v = low; v.x <= high.x; ++v.x) {
      for (v.y = low.y; v.y <= high.y; ++v.y) {
        for (v.z = low.z; v.z <= high.z; ++v.z) look(v);
      }
    }
  }

 private:
  Vec3 seen(const VoxelIndex& voxel) const {
    const Vec3 centre = map_.centre_of(voxel);
    if (!scene_.motion.any()) return start_.rotate_back(centre - start_.translation);
    const oracle::Track::Heard heard = track_.heard(centre);
    return mapperd::map::fan_point(heard.range_m, heard.bearing_rad, heard.elevation_rad);
  }

  void look(const VoxelIndex& voxel) {
    if (++looked_ % every != 0) return;
    const VoxelState state = map_.at(voxel);
    const Vec3 coarse = start_.rotate_back(map_.centre_of(voxel) - start_.translation);
    if (state.count == 0 &&
        (nodes_.oracle.inside_aperture(coarse) < -8 || coarse.x < -8 * map_.resolution_m()))
      return;
    if (nodes_.grid().is_empty()) {
      wrong += state.count;
      return;
    }
    const Vec3 v = seen(voxel);
    const auto block = [](std::int64_t i) { return static_cast<std::int32_t>(i >> 4); };
    if (!scene_.limit.holds({block(voxel.x), block(voxel.y), block(voxel.z)})) {
      wrong += state.count != 0 ? 1 : 0;
      return;
    }
    if (!agrees(v, state)) {
      if (++wrong <= 3 && !quiet) print(v, state);
    }
    const Evidence own = nodes_.oracle.at(v);
    const Class is = state.count == 0 ? Class::kNothing
                     : is_free(state) ? Class::kFree
                                      : Class::kOccupied;
    Class volume = Class::kNothing;
    if (by_volume) {
      volume = oracle::class_of(nodes_.oracle.volume(v, start_, 12, 5));
      if (volume != oracle::class_of(own)) ++other_volume;
    }
    if (is == Class::kNothing && oracle::class_of(own) == Class::kNothing &&
        volume == Class::kNothing) {
      return;
    }
    ++compared;
    occupied += is == Class::kOccupied ? 1 : 0;
    if (is != oracle::class_of(own)) ++other_class;
  }

  bool is_free(const VoxelState& state) const {
    return std::abs(state.log_odds - scene_.settings.iwlo.L_free) < 1e-3;
  }

  bool agrees(const Vec3& v, const VoxelState& state) {
    const double edge_m = map_.resolution_m();
    const double range = norm(v) / edge_m;
    const double inside = nodes_.oracle.inside_aperture(v);
    // Cells beyond 24 voxels are looked up along lines, which depart from circles by half the
    // square of a cell's half diagonal over the range; a moving sonar's by a twentieth more.
    const double moved = scene_.motion.any() ? 0.06 : 0.0;
    const double flat = std::max(std::hypot(v.x, v.y) / edge_m, 1.0);
    const double along = (range > 20 ? 3.4 / range : 0.0) + moved;
    double across = (range > 20 ? 6.8 / flat : 0.0) + moved;
    // Neighbouring beams of such cells may differ in width by 15 %.
    if (scene_.table != Table::kEvenSine && range > 20) across += 0.15 * 2.6;
    const double face =
        1e-4 + moved + std::sin(scene_.settings.ping.vertical_aperture_rad / 2) * 3.4 / flat;
    const double sine = PingOracle::sine_of(v);
    const double row = nodes_.row_of(norm(v)), column = nodes_.column_of(sine);
    const double columns_per_edge =
        nodes_.oracle.half_width(norm(v), sine) / 0.54 * nodes_.grid().subcolumns();
    const auto rows =
        static_cast<std::int64_t>(1 + std::floor(along * edge_m / nodes_.grid().row_pitch_m()));
    const auto columns = static_cast<std::int64_t>(1 + std::floor(across * columns_per_edge));
    const bool may_be_nothing = inside < face || std::abs(v.x) < 1e-4 * edge_m;
    if (state.count == 0 && (inside <= -0.5 + face || v.x < 1e-4 * edge_m)) return true;
    if (inside <= -0.5 - face || v.x < -1e-4 * edge_m) return false;
    if (inside <= -face && is_free(state)) return false;
    const auto row_at = static_cast<std::int64_t>(std::floor(row));
    const auto column_at = static_cast<std::int64_t>(std::floor(column));
    for (std::int64_t i = 0; i <= rows; ++i) {
      for (std::int64_t j = 0; j <= columns; ++j) {
        for (int side = 0; side < 4; ++side) {
          const std::int64_t at_row = row_at + (side % 2 == 0 ? i : -i);
          if (at_row < 0) continue;
          const std::int64_t at_column = column_at + (side / 2 == 0 ? j : -j);
          const Evidence& e = nodes_.at(at_row, at_column);
          const double tolerance =
              nodes_.tolerance(nodes_.range_of(at_row), nodes_.sine_of(at_column));
          if (nodes_.makes(e, tolerance, state)) return true;
          // Beside the aperture whatever is not occupied is nothing.
          if (may_be_nothing && state.count == 0 && e.returns < 0.02 + tolerance) return true;
        }
      }
    }
    return false;
  }

  void print(const Vec3& v, const VoxelState& state) const {
    const double edge_m = map_.resolution_m();
    const Evidence e = nodes_.oracle.at(norm(v), PingOracle::sine_of(v));
    std::printf(
        "  %s: voxel at %.2f %.2f %.2f edges, %.3f inside: count %d log-odds %.4f, N %.4f F %.4f w "
        "%.4f row %.2f column %.2f\n",
        scene_.name.c_str(), v.x / edge_m, v.y / edge_m, v.z / edge_m,
        nodes_.oracle.inside_aperture(v), state.count, state.log_odds, e.returns, e.free,
        e.weight(), nodes_.row_of(norm(v)), nodes_.column_of(PingOracle::sine_of(v)));
  }

  const Scene& scene_;
  Nodes nodes_;
  VoxelMap map_;
  oracle::Track track_;
  Transform start_;
  long looked_ = 0;
};

TEST_CASE("every voxel takes the value of a node within one pitch of its centre") {
  int compared = 0, occupied = 0, wrong = 0;
  for (int seed = 100; seed < 100 + scene_count(120); ++seed) {
    const Scene scene = scene_of(static_cast<std::uint64_t>(seed));
    Comparison comparison(scene);
    comparison.run();
    CHECK(comparison.wrong == 0);
    if (comparison.wrong > 0) std::printf("  %s: %d wrong\n", scene.name.c_str(), comparison.wrong);
    compared += comparison.compared;
    occupied += comparison.occupied;
    wrong += comparison.wrong;
  }
  std::printf("  %d voxels, %d occupied, %d wrong\n", compared, occupied, wrong);
  CHECK((kSanitized || (compared > 100000 && occupied > 10000)));
}

// A sonar's usual ping: 20 degrees of aperture, 128 beams, some rows of a wandering surface.
Scene usual_scene(std::uint64_t seed) {
  scenes::Random random(seed);
  Scene scene;
  scenes::Ragged want;
  want.thickness = 6;
  want.jump = 0.05;
  want.rows = 200;
  want.half_fan_rad = 1.1;
  want.max_range_m = 10;
  scene.ping = scenes::ragged_ping(want, random);
  scene.settings.edge_m = 0.2;
  scene.pose = scenes::random_pose(random);
  return scene;
}

TEST_CASE("a moving sonar mapped as if at rest changes many voxels") {
  for (std::uint64_t seed = 310; seed < 312; ++seed) {
    Scene scene = usual_scene(seed);
    scene.settings.edge_m = 0.3;
    scenes::Random random(seed);
    scene.motion = scenes::motion_of(2.0, 1.0, random, 300);
    Comparison with(scene), without(scene, {});
    without.quiet = true;
    with.run();
    without.run();
    std::printf("  %d voxels: %d of another class than their centres, %d if mapped as at rest\n",
                with.compared, with.other_class, without.other_class);
    CHECK((with.wrong == 0 && without.wrong > with.wrong));
    CHECK(without.other_class > 2 * with.other_class);
  }
}

// Open water up to a wall, over a hundred voxels and more: whole blocks are free, and what is
// settled for all of a block must hold for its outermost voxels.
TEST_CASE("open water is free up to the wall and the aperture's faces, and nothing beyond is") {
  for (std::uint64_t seed = 340; seed < 340 + (kSanitized ? 1 : 6); ++seed) {
    scenes::Random random(seed);
    scenes::Ping ping = scenes::empty_ping(100, 64, random.uniform(0.4, 1.2), 10.0);
    for (std::size_t j = 0; j < 64; ++j) ping.intensity[90 * 64 + j] = 200.0F;
    oracle::Settings settings;
    settings.edge_m = 10.0 / random.uniform(70, 130);
    settings.ping.vertical_aperture_rad = random.uniform(0.5, 1.4);
    settings.ping.min_range_m = 1.0;
    const PingOracle judge(ping.image(), settings);
    const Transform pose = scenes::random_pose(random);
    VoxelMap map(settings.edge_m, {});
    integrate_evidence_grid(map, ping.image(), pose, settings.ping);
    // Rows and columns are met within a pitch, lines within 3.4 / 24 voxels.
    const double slack = 0.3 + 0.15, beside = 0.6 + 0.3;
    const double edge_m = settings.edge_m;
    const double last = judge.sine_at(64);
    std::size_t free = 0, missing = 0, beyond = 0;
    const auto in_sonar = [&](const VoxelIndex& v) {
      return pose.rotate_back(map.centre_of(v) - pose.translation);
    };
    map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
      const Vec3 v = in_sonar(voxel);
      const double inside = judge.inside_aperture(v);
      const double out = (std::abs(PingOracle::sine_of(v)) - last) * std::hypot(v.x, v.y) / edge_m;
      const bool is_free = state.log_odds < 0;
      free += is_free ? 1 : 0;
      if (is_free
              ? inside < -0.08 || norm(v) > 9.0 + slack * edge_m || out > beside
              : inside < -0.58 || norm(v) < 9.0 - (0.54 + slack) * edge_m || out > beside + 0.54) {
        ++beyond;
      }
    });
    VoxelIndex low, high;
    CHECK(map.index_of(pose.translation - Vec3{10, 10, 10}, low));
    CHECK(map.index_of(pose.translation + Vec3{10, 10, 10}, high));
    for (VoxelIndex at = low; at.x <= high.x; ++at.x) {
      for (at.y = low.y; at.y <= high.y; ++at.y) {
        for (at.z = low.z; at.z <= high.z; ++at.z) {
          const Vec3 v = in_sonar(at);
          if (v.x < edge_m || judge.inside_aperture(v) < 0.08) continue;
          const double range = norm(v);
          const double out =
              (std::abs(PingOracle::sine_of(v)) - last) * std::hypot(v.x, v.y) / edge_m;
          if (range < 1.0 + slack * edge_m || range > 9.0 - (0.54 + slack) * edge_m ||
              out > -beside) {
            continue;
          }
          if (!(map.at(at).log_odds < 0)) ++missing;
        }
      }
    }
    CHECK((free > 100000 && missing == 0 && beyond == 0));
  }
}

// So far away that cells and blocks of a moving sonar are seen as turned; where it turns fast, as
// bent.
TEST_CASE("far away a moving sonar is as near to the definition as one at rest") {
  double at_rest = 0.0;
  for (const double rate_radps : {0.0, 0.8, 9.0}) {
    int compared = 0, others = 0;
    for (std::uint64_t seed = 320; seed < 320 + (kSanitized ? 1 : 3); ++seed) {
      scenes::Random random(seed);
      Scene scene;
      scenes::Ragged want;
      want.thickness = 6;
      want.jump = 0.05;
      want.beams = 256;
      want.surface = 0.8;
      scene.ping = scenes::ragged_ping(want, random);
      scene.settings.edge_m = 0.1;
      scene.settings.ping.vertical_aperture_rad = 0.2;
      scene.settings.ping.min_range_m = 14;
      scene.pose = scenes::random_pose(random);
      if (rate_radps > 0) scene.motion = scenes::motion_of(1.0, rate_radps, random);
      Comparison comparison(scene);
      comparison.every = 41;
      comparison.run();
      CHECK(comparison.wrong == 0);
      compared += comparison.compared;
      others += comparison.other_class;
    }
    const double share = static_cast<double>(others) / compared;
    std::printf("  turning by %.1f rad/s: %d voxels, %.2f %% of another class than their centres\n",
                rate_radps, compared, 100 * share);
    if (!(rate_radps > 0)) at_rest = share;
    CHECK(share <= 1.15 * at_rest);
  }
}

// Where the rows of the grid were a whole multiple of the ping's, rounding to the nearest one would
// widen or narrow every surface alike.
TEST_CASE("the grid's rows meet the ping's rows at all phases") {
  for (const double rows_per_pitch : {0.5, 1.0, 1.5, 2.0, 3.0, 3.7}) {
    scenes::Ping ping = scenes::empty_ping(400, 16, 0.5, 4.0);
    ping.intensity.assign(400 * 16, 200.0F);
    const double edge_m = rows_per_pitch * ping.range_resolution_m / 0.3;
    mapperd::map::GridMemory memory;
    const mapperd::map::IwloRule rule({});
    const EvidenceGrid grid(memory, ping.image(), {}, rule, edge_m);
    CHECK((grid.row_pitch_m() <= 0.3 * edge_m && grid.row_pitch_m() >= 0.27 * edge_m));
    std::vector<double> phases;
    for (int row = 0; row < 100; ++row) {
      const double at = (row + 0.5) * grid.row_pitch_m() / ping.range_resolution_m;
      phases.push_back(at - std::floor(at));
    }
    std::sort(phases.begin(), phases.end());
    double gap = 1.0 - phases.back() + phases.front();
    for (std::size_t i = 1; i < phases.size(); ++i) gap = std::max(gap, phases[i] - phases[i - 1]);
    CHECK(gap < 0.1);
  }
}

// Both the pitch and the lines that voxels beyond 24 are looked up along take part: what is left at
// the finest pitch is theirs.
TEST_CASE("a finer grid comes nearer to the definition at each voxel's centre") {
  double last = 0.035;
  for (const double detail : {1.0, 2.0, 4.0, 8.0}) {
    int compared = 0, others = 0, occupied = 0;
    for (std::uint64_t seed = 300; seed < 300 + (kSanitized ? 1 : 4); ++seed) {
      Scene scene = usual_scene(seed);
      scene.settings.ping.detail = detail;
      Comparison comparison(scene);
      comparison.run();
      CHECK(comparison.wrong == 0);
      compared += comparison.compared;
      others += comparison.other_class;
      occupied += comparison.occupied;
    }
    const double share = static_cast<double>(others) / compared;
    std::printf("  detail %.0f: %d voxels, %d occupied, %.3f %% of another class\n", detail,
                compared, occupied, 100 * share);
    CHECK(share < last);
    last = share;
  }
}

// The finer the voxels, the fewer are cut by the aperture's faces, where a voxel's centre stands
// for its volume.
TEST_CASE("the definition's classes are those of parts of the voxel's volume") {
  for (const double edge_m : {0.3, 0.12}) {
    int compared = 0, others = 0, apart = 0;
    for (std::uint64_t seed = 300; seed < 300 + (kSanitized ? 1 : 3); ++seed) {
      Scene scene = usual_scene(seed);
      scene.settings.edge_m = edge_m;
      Comparison comparison(scene);
      comparison.every = edge_m < 0.2 ? 19 : 3;
      comparison.by_volume = true;
      comparison.run();
      CHECK(comparison.wrong == 0);
      compared += comparison.compared;
      others += comparison.other_volume;
      apart += comparison.other_class;
    }
    std::printf("  voxels of %.2f m: %d, %.2f %% of another class by volume, %.2f %% by the grid\n",
                edge_m, compared, 100.0 * others / compared, 100.0 * apart / compared);
    CHECK((kSanitized || others < compared * (edge_m < 0.2 ? 0.04 : 0.08)));
  }
}

}  // namespace
