// The map and its integrators.
#include <pybind11/pybind11.h>

#include <algorithm>
#include <limits>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
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
                     const std::string& aggregation, double error_bound, int threads) {
  const Ping ping(intensity, bearings, range_resolution_m);
  const Transform pose = transform_of(map_T_sonar, "map_T_sonar");
  const FanSettings settings{vertical_aperture_rad, min_range_m, carve_no_return,
                             aggregation_of(aggregation), error_bound, threads};
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
    map.for_each_known([&](const VoxelIndex& voxel, const VoxelState& state) {
      if (!(state.log_odds > min_log_odds && state.log_odds < max_log_odds)) return;
      const Vec3 centre = map.centre_of(voxel);
      centres.insert(centres.end(), {centre.x, centre.y, centre.z});
      log_odds.push_back(state.log_odds);
      counts.push_back(state.count);
    });
  }
  const auto n = static_cast<py::ssize_t>(log_odds.size());
  return py::make_tuple(py::array_t<double>({n, py::ssize_t{3}}, centres.data()),
                        py::array_t<float>(n, log_odds.data()),
                        py::array_t<std::uint16_t>(n, counts.data()));
}

// A slice of the sorted blocks, every voxel written out.
py::tuple blocks(const VoxelMap& map, std::size_t begin, std::size_t count) {
  auto sorted = map.sorted_blocks();
  begin = std::min(begin, sorted.size());
  count = std::min(count, sorted.size() - begin);
  const auto n = static_cast<py::ssize_t>(count);
  py::array_t<std::int32_t> keys({n, py::ssize_t{3}});
  py::array_t<std::int32_t> units({n, py::ssize_t{kBlockVoxels}});
  py::array_t<std::uint16_t> counts({n, py::ssize_t{kBlockVoxels}});
  auto* key = keys.mutable_data();
  auto* unit = units.mutable_data();
  auto* seen = counts.mutable_data();
  for (std::size_t b = begin; b < begin + count; ++b) {
    *key++ = sorted[b]->key.x;
    *key++ = sorted[b]->key.y;
    *key++ = sorted[b]->key.z;
    for (int i = 0; i < kBlockVoxels; ++i) {
      const Voxel voxel = sorted[b]->voxel(map.rule(), i);
      *unit++ = voxel.units;
      *seen++ = voxel.count;
    }
  }
  return py::make_tuple(keys, units, counts);
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
      .def_property_readonly("revision", &VoxelMap::revision)
      .def_property_readonly("block_count", &VoxelMap::block_count)
      .def_property_readonly("memory_bytes", &VoxelMap::memory_bytes)
      .def("integrate_projective", &projective, "intensity"_a, "bearings_rad"_a,
           "range_resolution_m"_a, "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "carve_no_return"_a = fan.carve_no_return,
           "aggregation"_a = "occupied_first", "error_bound"_a = fan.error_bound,
           "threads"_a = fan.threads)
      .def("integrate_rays", &rays, "intensity"_a, "bearings_rad"_a, "range_resolution_m"_a,
           "map_T_sonar"_a, py::kw_only(), "vertical_aperture_rad"_a,
           "min_range_m"_a = fan.min_range_m, "angular_cone_width"_a = 0.5)
      .def("voxels", &voxels, "min_log_odds"_a = -kInfinity, "max_log_odds"_a = kInfinity)
      .def("blocks", &blocks, "begin"_a = 0, "count"_a = std::numeric_limits<std::size_t>::max())
      .def("query", &query, "points_m"_a)
      .def("clear", &VoxelMap::clear);
}

}  // namespace mapperd::bind
