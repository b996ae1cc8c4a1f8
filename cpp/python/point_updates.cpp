// Evidence about single points, and whole maps from whole maps, as methods of VoxelMap.
#include "mapperd/map/point_updates.hpp"

#include <pybind11/pybind11.h>

#include <memory>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "mapperd/map/merge.hpp"
#include "points.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

void observe_points(VoxelMap& map, const py::object& points_m, const py::object& intensities,
                    const py::object& occupied, const py::object& weights) {
  const PointArray points(points_m, "points_m");
  const auto intensity = numbers_of(intensities, "intensities", points.rows());
  const auto flags = checked<bool>(occupied, "occupied", 1);
  if (flags.shape(0) != points.rows()) {
    throw std::invalid_argument("occupied must have one entry a point");
  }
  Array<double> factors;
  if (!weights.is_none()) factors = numbers_of(weights, "weights", points.rows());
  const ObservedPoints observed{points.view(), intensity.data(), flags.data(),
                                weights.is_none() ? nullptr : factors.data()};
  const py::gil_scoped_release release;
  observe(map, observed);
}

void add_steps(VoxelMap& map, const py::object& points_m, const py::object& steps, double low,
               double high) {
  const PointArray points(points_m, "points_m");
  const auto values = numbers_of(steps, "steps", points.rows());
  const py::gil_scoped_release release;
  add_log_odds(map, points.view(), values.data(), {low, high});
}

void set_values(VoxelMap& map, const py::object& points_m, const py::object& log_odds) {
  const PointArray points(points_m, "points_m");
  const auto values = numbers_of(log_odds, "log_odds", points.rows());
  const py::gil_scoped_release release;
  set_log_odds(map, points.view(), values.data());
}

void ray(VoxelMap& map, const py::object& origin_m, const py::object& end_m, double hit,
         double miss, double low, double high) {
  const Vec3 origin = vec3_of(origin_m, "origin_m");
  const Vec3 end = vec3_of(end_m, "end_m");
  const py::gil_scoped_release release;
  add_ray(map, origin, end, hit, miss, {low, high});
}

void merge_all(VoxelMap& map, const py::args& others) {
  std::vector<const VoxelMap*> maps;
  for (const py::handle& other : others) maps.push_back(&other.cast<const VoxelMap&>());
  const py::gil_scoped_release release;
  merge(map, maps);
}

std::unique_ptr<VoxelMap> copy_with_rule(const VoxelMap& map, const IwloParams& iwlo) {
  const py::gil_scoped_release release;
  return std::make_unique<VoxelMap>(with_rule(map, iwlo));
}

}  // namespace

void bind_point_updates(py::module_& module) {
  static_cast<py::class_<VoxelMap>>(module.attr("VoxelMap"))
      .def("observe", &observe_points, "points_m"_a, "intensities"_a, "occupied"_a,
           "weights"_a = py::none())
      .def("add_log_odds", &add_steps, "points_m"_a, "steps"_a, py::kw_only(), "low"_a, "high"_a)
      .def("set_log_odds", &set_values, "points_m"_a, "log_odds"_a)
      .def("add_ray", &ray, "origin_m"_a, "end_m"_a, py::kw_only(), "hit"_a, "miss"_a, "low"_a,
           "high"_a)
      .def("merge", &merge_all)
      .def("with_rule", &copy_with_rule, "iwlo"_a);
}

}  // namespace mapperd::python
