// The map and its integrators.
#include <pybind11/pybind11.h>

#include <limits>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "mapperd/octomap_file.hpp"
#include "mapperd/projective.hpp"
#include "mapperd/rays.hpp"
#include "mapperd/voxel_map.hpp"

namespace mapperd::bind {
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
  if (name == "occupied_first") return Aggregation::occupied_first;
  if (name == "mean") return Aggregation::mean;
  throw std::invalid_argument("aggregation must be 'occupied_first' or 'mean', not '" + name + "'");
}

PingStats projective(VoxelMap& map, const py::object& intensity, const py::object& bearings,
                     double range_resolution_m, const py::object& map_T_sonar,
                     double vertical_aperture_rad, double min_range_m, bool carve_no_return,
                     const std::string& aggregation) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  const FanSettings settings{vertical_aperture_rad, min_range_m, carve_no_return,
                             aggregation_of(aggregation)};
  const py::gil_scoped_release release;
  return integrate_projective(map, ping.image, pose, settings);
}

PingStats rays(VoxelMap& map, const py::object& intensity, const py::object& bearings,
               double range_resolution_m, const py::object& map_T_sonar,
               double vertical_aperture_rad, double min_range_m, double angular_cone_width) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  const RaysSettings settings{vertical_aperture_rad, min_range_m, angular_cone_width};
  const py::gil_scoped_release release;
  return integrate_rays(map, ping.image, pose, settings);
}

py::tuple voxels(const VoxelMap& map, double min_log_odds, double max_log_odds) {
  std::vector<double> centres;
  std::vector<float> log_odds;
  std::vector<std::uint16_t> counts;
  {
    const py::gil_scoped_release release;
    for (const Block* block : map.sorted_blocks()) {
      for (int i = 0; i < kBlockVoxels; ++i) {
        const auto at = static_cast<std::size_t>(i);
        const double value = block->log_odds[at];
        if (block->count[at] == 0 || !(value > min_log_odds && value < max_log_odds)) continue;
        const Vec3 centre = map.voxel_centre(block->key, i);
        centres.insert(centres.end(), {centre.x, centre.y, centre.z});
        log_odds.push_back(block->log_odds[at]);
        counts.push_back(block->count[at]);
      }
    }
  }
  const auto n = static_cast<py::ssize_t>(log_odds.size());
  return py::make_tuple(py::array_t<double>({n, py::ssize_t{3}}, centres.data()),
                        py::array_t<float>(n, log_odds.data()),
                        py::array_t<std::uint16_t>(n, counts.data()));
}

py::tuple blocks(const VoxelMap& map) {
  const auto sorted = map.sorted_blocks();
  const auto n = static_cast<py::ssize_t>(sorted.size());
  py::array_t<std::int32_t> keys({n, py::ssize_t{3}});
  py::array_t<float> log_odds({n, py::ssize_t{kBlockVoxels}});
  py::array_t<std::uint16_t> counts({n, py::ssize_t{kBlockVoxels}});
  auto* key = keys.mutable_data();
  auto* value = log_odds.mutable_data();
  auto* count = counts.mutable_data();
  for (const Block* block : sorted) {
    *key++ = block->key.x;
    *key++ = block->key.y;
    *key++ = block->key.z;
    value = std::copy(block->log_odds.begin(), block->log_odds.end(), value);
    count = std::copy(block->count.begin(), block->count.end(), count);
  }
  return py::make_tuple(keys, log_odds, counts);
}

py::tuple query(const VoxelMap& map, const py::object& points_object) {
  const auto points = checked<double>(points_object, "points_m", 2);
  if (points.shape(1) != 3) throw std::invalid_argument("points_m must have shape (N, 3)");
  const auto at = points.unchecked<2>();
  py::array_t<float> log_odds(points.shape(0));
  py::array_t<std::uint16_t> counts(points.shape(0));
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    const VoxelState state = map.at(Vec3{at(i, 0), at(i, 1), at(i, 2)});
    log_odds.mutable_at(i) = state.log_odds;
    counts.mutable_at(i) = state.count;
  }
  return py::make_tuple(log_odds, counts);
}

py::bytes bt(const VoxelMap& map, double occupied_log_odds, double free_log_odds) {
  std::string file;
  {
    const py::gil_scoped_release release;
    file = octomap_bt(map, occupied_log_odds, free_log_odds);
  }
  return file;
}

}  // namespace

void bind_map(py::module_& module) {
  const FanSettings fan;
  py::class_<PingStats>(module, "PingStats")
      .def_readonly("occupied", &PingStats::occupied)
      .def_readonly("free", &PingStats::free)
      .def_readonly("blocks_visited", &PingStats::blocks_visited)
      .def_readonly("blocks_created", &PingStats::blocks_created);
  py::class_<VoxelMap>(module, "VoxelMap")
      .def(py::init<double, const IwloParams&>(), "resolution_m"_a, "iwlo"_a)
      .def_property_readonly("resolution_m", &VoxelMap::resolution_m)
      .def_property_readonly("block_count", &VoxelMap::block_count)
      .def_property_readonly("memory_bytes", &VoxelMap::memory_bytes)
      .def("integrate_projective", &projective, "intensity"_a, "bearings_rad"_a,
           "range_resolution_m"_a, "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "aggregation"_a = "occupied_first")
      .def("integrate_rays", &rays, "intensity"_a, "bearings_rad"_a, "range_resolution_m"_a,
           "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "angular_cone_width"_a = 0.5)
      .def("voxels", &voxels, "min_log_odds"_a = -kInfinity, "max_log_odds"_a = kInfinity)
      .def("blocks", &blocks)
      .def("query", &query, "points_m"_a)
      .def("octomap_bt", &bt, "occupied_log_odds"_a, "free_log_odds"_a)
      .def("clear", &VoxelMap::clear);
}

}  // namespace mapperd::bind
