// The map and its integrators.
#include <pybind11/pybind11.h>

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "mapperd/map/arc_integrator.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/ping_box.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/snapshot.hpp"
#include "mapperd/map/voxel_map.hpp"
#include "points.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The arrays behind a ping, kept alive while C++ reads them without the GIL.
struct Ping {
  Array<float> intensity;
  Array<double> bearings;
  PingImage image;

  Ping(const py::object& intensity_object, const py::object& bearings_object,
       double range_resolution_m)
      : intensity(checked<float>(intensity_object, "intensity", 2)),
        bearings(checked<double>(bearings_object, "bearings_rad", 1)) {
    if (bearings.shape(0) != intensity.shape(1)) {
      throw std::invalid_argument("bearings_rad must have one entry a column of intensity");
    }
    image = {intensity.data(), static_cast<std::size_t>(intensity.shape(0)),
             static_cast<std::size_t>(intensity.shape(1)), bearings.data(), range_resolution_m};
  }
};

Aggregation aggregation_of(const std::string& name) {
  if (name == "occupied_first") return Aggregation::kOccupiedFirst;
  if (name == "mean") return Aggregation::kMean;
  throw std::invalid_argument("aggregation must be 'occupied_first' or 'mean', not '" + name + "'");
}

PingStats evidence_grid(VoxelMap& map, const py::object& intensity, const py::object& bearings,
                        double range_resolution_m, const py::object& map_T_sonar,
                        double vertical_aperture_rad, double min_range_m, bool carve_no_return,
                        const std::string& aggregation, double detail, int threads,
                        const PingMotion& motion) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  const PingParams settings{vertical_aperture_rad,       min_range_m, carve_no_return,
                            aggregation_of(aggregation), detail,      threads};
  const py::gil_scoped_release release;
  return integrate_evidence_grid(map, ping.image, pose, settings, motion);
}

ArcParams arc_params(double half_aperture_rad, double beam_width_rad, double spread_below,
                     double spread_above, double broad_share, double missed_share,
                     double first_return, double quiet, double behind_scale, double min_step,
                     double max_step) {
  return {half_aperture_rad, beam_width_rad, spread_below, spread_above, broad_share, missed_share,
          first_return,      quiet,          behind_scale, min_step,     max_step};
}

// The arguments of a ping of the arc rule.
struct ArcPing {
  Ping ping;
  Array<float> noise;
  Transform map_T_sonar;
  PingParams settings;

  ArcPing(const ArcModel& model, const py::object& levels, const py::object& noise_object,
          const py::object& bearings, double range_resolution_m, const py::object& pose,
          double min_range_m, bool carve_no_return, int threads)
      : ping(levels, bearings, range_resolution_m),
        noise(checked<float>(noise_object, "noise", 1)),
        map_T_sonar(transform_of(pose, "map_T_sonar")) {
    if (static_cast<std::size_t>(noise.shape(0)) != ping.image.rows) {
      throw std::invalid_argument("noise must have one entry a row of levels");
    }
    settings.vertical_aperture_rad = 2 * model.params().half_aperture_rad;
    settings.min_range_m = min_range_m;
    settings.carve_no_return = carve_no_return;
    settings.threads = threads;
  }
  ArcImage image() const { return {ping.image, noise.data()}; }
};

PingStats arc(VoxelMap& map, const ArcModel& model, const py::object& levels,
              const py::object& noise, const py::object& bearings, double range_resolution_m,
              const py::object& map_T_sonar, double min_range_m, bool carve_no_return, int threads,
              const PingMotion& motion, ArcChanges* changes) {
  const ArcPing ping(model, levels, noise, bearings, range_resolution_m, map_T_sonar, min_range_m,
                     carve_no_return, threads);
  const ArcImage image = ping.image();
  const py::gil_scoped_release release;
  return integrate_arc(map, model, image, ping.map_T_sonar, ping.settings, motion, changes);
}

PingStats arc_again(VoxelMap& map, const ArcModel& model, const py::object& levels,
                    const py::object& noise, const py::object& bearings, double range_resolution_m,
                    const py::object& map_T_sonar, ArcChanges& changes, double min_range_m,
                    bool carve_no_return, int threads, const PingMotion& motion) {
  const ArcPing ping(model, levels, noise, bearings, range_resolution_m, map_T_sonar, min_range_m,
                     carve_no_return, threads);
  const ArcImage image = ping.image();
  const py::gil_scoped_release release;
  return refine_arc(map, model, image, ping.map_T_sonar, ping.settings, motion, changes);
}

ArcChanges arc_changes(const py::object& counts, const py::object& steps) {
  const auto some_counts = checked<std::uint32_t>(counts, "counts", 1);
  const auto some_steps = checked<std::int16_t>(steps, "steps", 1);
  return {{some_counts.data(), some_counts.data() + some_counts.size()},
          {some_steps.data(), some_steps.data() + some_steps.size()}};
}

PingStats rays(VoxelMap& map, const py::object& intensity, const py::object& bearings,
               double range_resolution_m, const py::object& map_T_sonar,
               double vertical_aperture_rad, double min_range_m, double angular_cone_width,
               const PingMotion& motion) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  const RaysParams settings{vertical_aperture_rad, min_range_m, angular_cone_width};
  const py::gil_scoped_release release;
  return integrate_rays(map, ping.image, pose, settings, motion);
}

py::object blocks_of(const VoxelMap& map, const py::object& intensity, const py::object& bearings,
                     double range_resolution_m, const py::object& map_T_sonar,
                     double vertical_aperture_rad, double min_range_m, bool carve_no_return,
                     const PingMotion& motion) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  PingParams settings;
  settings.vertical_aperture_rad = vertical_aperture_rad;
  settings.min_range_m = min_range_m;
  settings.carve_no_return = carve_no_return;
  std::optional<BlockBox> box;
  {
    const py::gil_scoped_release release;
    box = blocks_of_ping(map, ping.image, pose, settings, motion);
  }
  if (!box) return py::none();
  const auto key = [](const BlockKey& block) { return py::make_tuple(block.x, block.y, block.z); };
  return py::make_tuple(key(box->first), key(box->last));
}

PingMotion motion_of(const py::object& linear_mps, const py::object& angular_radps, double valid_s,
                     double speed_of_sound_mps) {
  return {vec3_of(linear_mps, "linear_mps"), vec3_of(angular_radps, "angular_radps"), valid_s,
          speed_of_sound_mps};
}

py::tuple voxels(const VoxelMap& map, double min_log_odds, double max_log_odds) {
  std::vector<KnownVoxel> found;
  {
    const py::gil_scoped_release release;
    found = voxels_between(map, min_log_odds, max_log_odds);
  }
  return arrays_of(map, found);
}

py::tuple arrays_of(const DenseBlocks& dense) {
  const auto n = static_cast<py::ssize_t>(dense.keys.size());
  static_assert(sizeof(BlockKey) == 3 * sizeof(std::int32_t));
  const auto* keys = reinterpret_cast<const std::int32_t*>(dense.keys.data());
  return py::make_tuple(
      py::array_t<std::int32_t>({n, py::ssize_t{3}}, keys),
      py::array_t<std::int32_t>({n, py::ssize_t{kBlockVoxels}}, dense.units.data()),
      py::array_t<std::uint16_t>({n, py::ssize_t{kBlockVoxels}}, dense.counts.data()));
}

py::tuple blocks(const VoxelMap& map, std::size_t begin, std::size_t count) {
  DenseBlocks dense;
  {
    const py::gil_scoped_release release;
    dense = dense_blocks(map, begin, count);
  }
  return arrays_of(dense);
}

// The map is locked for reading while the visitor runs. Threads that wait to write hold no GIL.
void visit_blocks(const VoxelMap& map, const py::function& visit, std::size_t at_once) {
  if (at_once == 0) throw std::invalid_argument("at_once must be 1 or more");
  const py::gil_scoped_release release;
  for_dense_blocks(map, at_once, [&visit](const DenseBlocks& dense) {
    const py::gil_scoped_acquire acquire;
    visit(*arrays_of(dense));
  });
}

py::tuple query(const VoxelMap& map, const py::object& points_object) {
  const PointArray points(points_object, "points_m");
  std::vector<VoxelState> states;
  {
    const py::gil_scoped_release release;
    states = states_at(map, points.view());
  }
  py::array_t<float> log_odds(points.rows());
  py::array_t<std::uint16_t> counts(points.rows());
  for (py::ssize_t i = 0; i < points.rows(); ++i) {
    log_odds.mutable_at(i) = states[static_cast<std::size_t>(i)].log_odds;
    counts.mutable_at(i) = states[static_cast<std::size_t>(i)].count;
  }
  return py::make_tuple(log_odds, counts);
}

py::tuple class_counts(const VoxelMap& map, double occupied_log_odds, double free_log_odds) {
  ClassCounts counts;
  {
    const py::gil_scoped_release release;
    counts = count_classes(map, {occupied_log_odds, free_log_odds});
  }
  return py::make_tuple(counts.occupied, counts.free, counts.uncertain);
}

// Never wait for the map with the GIL held: the thread that holds the map may need the GIL.
MapSize size_without_gil(const VoxelMap& map) {
  const py::gil_scoped_release release;
  return size_of(map);
}

// Asked with every ping, as the revision is: `size_of` counts voxel by voxel.
std::size_t memory_without_gil(const VoxelMap& map) {
  const py::gil_scoped_release release;
  return memory_bytes(map);
}

std::uint64_t revision_without_gil(const VoxelMap& map) {
  const py::gil_scoped_release release;
  const ReadLock lock(map);
  return map.revision();
}

}  // namespace

void bind_map(py::module_& module) {
  const PingParams fan;
  const PingMotion still;
  py::class_<PingMotion>(module, "PingMotion")
      .def(py::init(&motion_of), py::kw_only(), "linear_mps"_a, "angular_radps"_a, "valid_s"_a,
           "speed_of_sound_mps"_a);
  py::class_<PingStats>(module, "PingStats")
      .def(py::init<>())
      .def_readonly("occupied", &PingStats::occupied)
      .def_readonly("free", &PingStats::free)
      .def_readonly("blocks_visited", &PingStats::blocks_visited)
      .def_readonly("blocks_created", &PingStats::blocks_created);
  const ArcParams arcs;
  py::class_<ArcParams>(module, "ArcParams")
      .def(py::init(&arc_params), py::kw_only(), "half_aperture_rad"_a = arcs.half_aperture_rad,
           "beam_width_rad"_a = arcs.beam_width_rad, "spread_below"_a = arcs.spread_below,
           "spread_above"_a = arcs.spread_above, "broad_share"_a = arcs.broad_share,
           "missed_share"_a = arcs.missed_share, "first_return"_a = arcs.first_return,
           "quiet"_a = arcs.quiet, "behind_scale"_a = arcs.behind_scale,
           "min_step"_a = arcs.min_step, "max_step"_a = arcs.max_step)
      .def_property_readonly("free_step",
                             [](const ArcParams& params) { return ArcModel::free_step(params); });
  py::class_<ArcChanges>(module, "ArcChanges")
      .def(py::init<>())
      .def(py::init(&arc_changes), "counts"_a, "steps"_a)
      .def_property_readonly("counts",
                             [](const ArcChanges& changes) {
                               return py::array_t<std::uint32_t>(
                                   static_cast<py::ssize_t>(changes.counts.size()),
                                   changes.counts.data());
                             })
      .def_property_readonly("steps", [](const ArcChanges& changes) {
        return py::array_t<std::int16_t>(static_cast<py::ssize_t>(changes.steps.size()),
                                         changes.steps.data());
      });
  py::class_<ArcModel>(module, "ArcModel")
      .def(py::init([](const ArcParams& params, const IwloParams& rule) {
             return ArcModel(params, IwloRule(rule));
           }),
           "params"_a, "rule"_a);
  py::class_<VoxelMap>(module, "VoxelMap")
      .def(py::init<double, const IwloParams&>(), "resolution_m"_a, "iwlo"_a)
      .def_property_readonly("resolution_m", &VoxelMap::resolution_m)
      .def_property_readonly("revision", &revision_without_gil)
      .def_property_readonly("block_count",
                             [](const VoxelMap& map) { return size_without_gil(map).blocks; })
      .def_property_readonly("memory_bytes", &memory_without_gil)
      .def_property_readonly("held_voxels",
                             [](const VoxelMap& map) { return size_without_gil(map).held_voxels; })
      .def("integrate_evidence_grid", &evidence_grid, "intensity"_a, "bearings_rad"_a,
           "range_resolution_m"_a, "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "aggregation"_a = "occupied_first", "detail"_a = fan.detail, "threads"_a = fan.threads,
           "motion"_a = still)
      .def("integrate_arc", &arc, "model"_a, "levels"_a, "noise"_a, "bearings_rad"_a,
           "range_resolution_m"_a, "map_T_sonar"_a, py::kw_only(),
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "threads"_a = fan.threads, "motion"_a = still, "changes"_a = nullptr)
      .def("refine_arc", &arc_again, "model"_a, "levels"_a, "noise"_a, "bearings_rad"_a,
           "range_resolution_m"_a, "map_T_sonar"_a, py::kw_only(), "changes"_a,
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "threads"_a = fan.threads, "motion"_a = still)
      .def("integrate_rays", &rays, "intensity"_a, "bearings_rad"_a, "range_resolution_m"_a,
           "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "angular_cone_width"_a = 0.5, "motion"_a = still)
      .def("blocks_of_ping", &blocks_of, "intensity"_a, "bearings_rad"_a, "range_resolution_m"_a,
           "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "motion"_a = still)
      .def("voxels", &voxels, "min_log_odds"_a = -kInfinity, "max_log_odds"_a = kInfinity)
      .def("blocks", &blocks, "begin"_a = 0, "count"_a = std::numeric_limits<std::size_t>::max())
      .def("visit_blocks", &visit_blocks, "visit"_a, "at_once"_a)
      .def("class_counts", &class_counts, "occupied_log_odds"_a, "free_log_odds"_a)
      .def("query", &query, "points_m"_a)
      .def("set_intensity_threshold", &set_intensity_threshold, "intensity"_a,
           py::call_guard<py::gil_scoped_release>())
      .def("clear", static_cast<void (*)(VoxelMap&)>(&clear),
           py::call_guard<py::gil_scoped_release>());
}

}  // namespace mapperd::python
