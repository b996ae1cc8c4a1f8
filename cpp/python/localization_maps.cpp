// What the particle filter knows of the map and of the scan.
#include <pybind11/pybind11.h>

#include <utility>

#include "bindings.hpp"
#include "localization_types.hpp"
#include "mapperd/localization/distance_transform.hpp"
#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/kld.hpp"
#include "mapperd/localization/range_map.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

loc::GridFrame frame_of(const py::array& cells, double resolution_m, const py::object& origin) {
  return {static_cast<std::size_t>(cells.shape(0)), static_cast<std::size_t>(cells.shape(1)),
          resolution_m, pose_of(origin, "origin")};
}

loc::OccupancyGrid grid_of(const py::object& occupancy, double resolution_m,
                           const py::object& origin) {
  const auto cells = checked<std::int8_t>(occupancy, "occupancy", 2);
  return {frame_of(cells, resolution_m, origin),
          std::vector<std::int8_t>(cells.data(), cells.data() + cells.size())};
}

loc::UnknownSpace unknown_of(const std::string& name) {
  if (name == "as_free") return loc::UnknownSpace::kAsFree;
  if (name == "background") return loc::UnknownSpace::kBackground;
  if (name == "uniform") return loc::UnknownSpace::kUniform;
  throw std::invalid_argument("unknown must be as_free, background or uniform, not " + name);
}

loc::LikelihoodField field_of_grid(const loc::OccupancyGrid& grid, const loc::HitModel& model,
                                   bool only_boundaries, const std::string& unknown, int threads) {
  const loc::ObstacleParams rule{only_boundaries, unknown_of(unknown)};
  const py::gil_scoped_release release;
  return loc::LikelihoodField(grid, model, rule, threads);
}

loc::LikelihoodField field_of_values(const py::object& values, double resolution_m,
                                     const py::object& origin, double outside) {
  const auto cells = checked<float>(values, "values", 2);
  return loc::LikelihoodField(frame_of(cells, resolution_m, origin),
                              std::vector<float>(cells.data(), cells.data() + cells.size()),
                              outside);
}

loc::LikelihoodField field_of_distances(const py::object& distances_m,
                                        const py::object& first_centre_m, double resolution_m,
                                        const loc::HitModel& model) {
  const auto cells = checked<float>(distances_m, "distances_m", 3);
  const auto first = vector_of<double>(first_centre_m, "first_centre_m");
  if (first.size() != 3) throw std::invalid_argument("first_centre_m must have shape (3,)");
  std::array<std::size_t, 3> size;
  for (std::size_t k = 0; k < 3; ++k) {
    size[k] = static_cast<std::size_t>(cells.shape(static_cast<py::ssize_t>(k)));
  }
  const std::vector<float> values(cells.data(), cells.data() + cells.size());
  const py::gil_scoped_release release;
  return loc::LikelihoodField(values, size, {first[0], first[1], first[2]}, resolution_m, model);
}

py::array_t<float> layer_values(const loc::LikelihoodField& field, std::size_t layer) {
  const auto rows = field.frame().rows;
  const auto columns = field.frame().columns;
  if (layer >= field.layers()) throw std::invalid_argument("the field has no such layer");
  py::array_t<float> array({static_cast<py::ssize_t>(rows), static_cast<py::ssize_t>(columns)});
  float* to = array.mutable_data();
  for (std::size_t r = 0; r < rows; ++r) {
    for (std::size_t c = 0; c < columns; ++c) *to++ = field.at(layer, r, c);
  }
  return array;
}

loc::Endpoints endpoints_of(const py::object& points_m, const py::object& quality) {
  const auto points = checked<double>(points_m, "points_m", 3);
  const py::ssize_t axes = points.shape(2);
  if (axes != 2 && axes != 3) {
    throw std::invalid_argument("points_m must have shape (beams, elevations, 2 or 3)");
  }
  loc::Endpoints ends;
  ends.fan = static_cast<std::size_t>(points.shape(1));
  ends.quality = vector_of<double>(quality, "quality");
  const double* row = points.data();
  for (py::ssize_t k = 0; k < points.shape(0) * points.shape(1); ++k, row += axes) {
    ends.x_m.push_back(row[0]);
    ends.y_m.push_back(row[1]);
    if (axes == 3) ends.z_m.push_back(row[2]);
  }
  loc::check_endpoints(ends);
  return ends;
}

loc::Beams beams_of(const py::object& bearing_rad, const py::object& range_m,
                    const py::object& quality, double sensor_x_m, double sensor_y_m) {
  loc::Beams beams{sensor_x_m, sensor_y_m, vector_of<double>(bearing_rad, "bearing_rad"),
                   vector_of<double>(range_m, "range_m"), vector_of<double>(quality, "quality")};
  loc::check_beams(beams);
  return beams;
}

py::array_t<double> ranges(const loc::RangeMap& map, const py::object& rays, double max_range_m) {
  const loc::Particles from = particles_of(rays, "rays");
  std::vector<double> found(from.size());
  {
    const py::gil_scoped_release release;
    for (std::size_t i = 0; i < from.size(); ++i) found[i] = map.cast(from.pose(i), max_range_m);
  }
  return array_of(found);
}

py::array_t<std::int32_t> distances_squared(const py::object& marked, std::int32_t limit,
                                            int threads) {
  const auto cells = checked<bool>(marked, "marked", 2);
  std::vector<std::uint8_t> flat(static_cast<std::size_t>(cells.size()));
  std::transform(cells.data(), cells.data() + cells.size(), flat.begin(),
                 [](bool mark) { return mark ? std::uint8_t{1} : std::uint8_t{0}; });
  const auto rows = static_cast<std::size_t>(cells.shape(0));
  const auto columns = static_cast<std::size_t>(cells.shape(1));
  const auto found = loc::squared_distances(flat, rows, columns, limit, threads);
  py::array_t<std::int32_t> array({cells.shape(0), cells.shape(1)});
  std::copy(found.begin(), found.end(), array.mutable_data());
  return array;
}

void bind_models(py::module_& module) {
  py::class_<loc::HitModel>(module, "MclHitModel")
      .def(py::init([](double z_hit, double z_rand, double sigma_hit_m, double max_range_m,
                       double max_distance_m) {
             const loc::HitModel model{z_hit, z_rand, sigma_hit_m, max_range_m, max_distance_m};
             loc::check_hit_model(model);
             return model;
           }),
           py::kw_only(), "z_hit"_a, "z_rand"_a, "sigma_hit_m"_a, "max_range_m"_a,
           "max_distance_m"_a)
      .def("density", &loc::HitModel::density, "distance_m"_a);
  py::class_<loc::BeamModel>(module, "MclBeamModel")
      .def(py::init([](double z_hit, double z_short, double z_max, double z_rand,
                       double sigma_hit_m, double lambda_short_per_m, double max_range_m) {
             const loc::BeamModel model{
                 z_hit, z_short, z_max, z_rand, sigma_hit_m, lambda_short_per_m, max_range_m};
             loc::check_beam_model(model);
             return model;
           }),
           py::kw_only(), "z_hit"_a, "z_short"_a, "z_max"_a, "z_rand"_a, "sigma_hit_m"_a,
           "lambda_short_per_m"_a, "max_range_m"_a)
      .def("density", py::vectorize(&loc::BeamModel::density), "range_m"_a, "expected_m"_a);
}

void bind_scans(py::module_& module) {
  py::class_<loc::Endpoints>(module, "MclEndpoints")
      .def(py::init(&endpoints_of), "points_m"_a, "quality"_a)
      .def("__len__", &loc::Endpoints::beams);
  py::class_<loc::Beams>(module, "MclBeams")
      .def(py::init(&beams_of), py::kw_only(), "bearing_rad"_a, "range_m"_a, "quality"_a,
           "sensor_x_m"_a = 0.0, "sensor_y_m"_a = 0.0)
      .def("__len__", &loc::Beams::size);
}

}  // namespace

void bind_localization_maps(py::module_& module) {
  bind_models(module);
  bind_scans(module);
  py::class_<loc::OccupancyGrid>(module, "MclGrid")
      .def(py::init([](const py::object& occupancy, double resolution_m, const py::object& origin) {
             loc::OccupancyGrid grid = grid_of(occupancy, resolution_m, origin);
             loc::check_frame(grid.frame);
             return grid;
           }),
           "occupancy"_a, "resolution_m"_a, "origin"_a);
  py::class_<loc::FreeSpace>(module, "MclFreeSpace")
      .def(py::init<const loc::OccupancyGrid&>(), "grid"_a)
      .def("__len__", &loc::FreeSpace::size);
  py::class_<loc::LikelihoodField>(module, "MclField")
      .def_static("of_grid", &field_of_grid, "grid"_a, "model"_a, "only_boundaries"_a = false,
                  "unknown"_a = "as_free", "threads"_a = 1)
      .def_static("of_values", &field_of_values, "values"_a, "resolution_m"_a, "origin"_a,
                  "outside"_a)
      .def_static("of_distances", &field_of_distances, "distances_m"_a, "first_centre_m"_a,
                  "resolution_m"_a, "model"_a)
      .def("values", &layer_values, "layer"_a = 0)
      .def_property_readonly("layers", &loc::LikelihoodField::layers)
      .def_property_readonly("background", &loc::LikelihoodField::background)
      .def_property_readonly("memory_bytes", &loc::LikelihoodField::memory_bytes);
  py::class_<loc::RangeMap>(module, "MclRangeMap")
      .def(py::init<const loc::OccupancyGrid&, bool, int>(), "grid"_a, "unknown_blocks"_a = false,
           "threads"_a = 1, py::call_guard<py::gil_scoped_release>())
      .def("cast", &ranges, "rays"_a, "max_range_m"_a);
  module.def("mcl_squared_distances", &distances_squared, "marked"_a, "limit"_a, "threads"_a = 1);
  module.def("mcl_kld_size", &loc::kld_size, "buckets"_a, "error"_a, "quantile"_a);
}

}  // namespace mapperd::python
