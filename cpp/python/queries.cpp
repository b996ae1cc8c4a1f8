// Questions to the map, as methods of VoxelMap.
#include "mapperd/map/queries.hpp"

#include <pybind11/pybind11.h>

#include <utility>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "mapperd/map/distance_field.hpp"
#include "points.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

// An array that owns the vector; T is the NumPy element type of a Stored.
template <typename T, typename Stored>
py::array_t<T> array_from(std::vector<Stored>&& values, const std::vector<py::ssize_t>& shape) {
  static_assert(sizeof(T) == sizeof(Stored));
  auto* owned = new std::vector<Stored>(std::move(values));
  const py::capsule owner(owned, [](void* p) { delete static_cast<std::vector<Stored>*>(p); });
  return py::array_t<T>(shape, reinterpret_cast<const T*>(owned->data()), owner);
}

std::vector<py::ssize_t> shape_of(const VoxelBox& box) {
  return {box.size.begin(), box.size.end()};
}

py::array_t<double> first_centre(const VoxelMap& map, const VoxelBox& box) {
  const Vec3 centre = map.centre_of(box.first);
  const double xyz[] = {centre.x, centre.y, centre.z};
  return py::array_t<double>(3, xyz);
}

py::array classify_points(const VoxelMap& map, const py::object& points_m, double occupied_log_odds,
                          double free_log_odds) {
  const PointArray points(points_m, "points_m");
  std::vector<Occupancy> answers;
  {
    const py::gil_scoped_release release;
    answers = classify(map, points.view(), {occupied_log_odds, free_log_odds});
  }
  return array_from<std::int8_t>(std::move(answers), {points.rows()});
}

py::tuple classify_grid(const VoxelMap& map, const py::object& low_m, const py::object& high_m,
                        double occupied_log_odds, double free_log_odds) {
  const VoxelBox box = box_of(map, vec3_of(low_m, "low_m"), vec3_of(high_m, "high_m"));
  std::vector<Occupancy> answers;
  {
    const py::gil_scoped_release release;
    answers = classify_box(map, box, {occupied_log_odds, free_log_odds});
  }
  return py::make_tuple(array_from<std::int8_t>(std::move(answers), shape_of(box)),
                        first_centre(map, box));
}

py::array depths(const VoxelMap& map, const py::object& origins_m, const py::object& directions,
                 double max_range_m, double occupied_log_odds) {
  const PointArray from(origins_m, "origins_m");
  const PointArray along(directions, "directions");
  std::vector<double> found;
  {
    const py::gil_scoped_release release;
    found = ray_cast_depth(map, from.view(), along.view(), max_range_m, occupied_log_odds);
  }
  return array_from<double>(std::move(found), {from.rows()});
}

py::tuple distances(const VoxelMap& map, const VoxelBox& box, double max_distance_m,
                    double occupied_log_odds) {
  std::vector<float> field;
  {
    const py::gil_scoped_release release;
    field = distance_field(map, box, max_distance_m, occupied_log_odds);
  }
  return py::make_tuple(array_from<float>(std::move(field), shape_of(box)), first_centre(map, box));
}

py::tuple distances_in_box(const VoxelMap& map, const py::object& low_m, const py::object& high_m,
                           double max_distance_m, double occupied_log_odds) {
  const VoxelBox box = box_of(map, vec3_of(low_m, "low_m"), vec3_of(high_m, "high_m"));
  return distances(map, box, max_distance_m, occupied_log_odds);
}

py::tuple distances_in_layer(const VoxelMap& map, const py::object& low_m, const py::object& high_m,
                             double z_m, double max_distance_m, double occupied_log_odds) {
  const VoxelBox box = layer_of(map, vec2_of(low_m, "low_m"), vec2_of(high_m, "high_m"), z_m);
  return distances(map, box, max_distance_m, occupied_log_odds);
}

py::tuple occupied_of_region(const VoxelMap& map, const py::object& low_m, const py::object& high_m,
                             double occupied_log_odds) {
  const VoxelBox box = box_of(map, vec3_of(low_m, "low_m"), vec3_of(high_m, "high_m"));
  std::vector<KnownVoxel> found;
  {
    const py::gil_scoped_release release;
    found = occupied_in(map, box, occupied_log_odds);
  }
  return arrays_of(map, found);
}

std::size_t count_known(const VoxelMap& map) {
  const py::gil_scoped_release release;
  return known_count(map);
}

}  // namespace

void bind_queries(py::module_& module) {
  static_cast<py::class_<VoxelMap>>(module.attr("VoxelMap"))
      .def("known_count", &count_known)
      .def("classify", &classify_points, "points_m"_a, "occupied_log_odds"_a, "free_log_odds"_a)
      .def("classify_box", &classify_grid, "low_m"_a, "high_m"_a, "occupied_log_odds"_a,
           "free_log_odds"_a)
      .def("ray_cast_depth", &depths, "origins_m"_a, "directions"_a, "max_range_m"_a,
           "occupied_log_odds"_a)
      .def("distance_field", &distances_in_box, "low_m"_a, "high_m"_a, "max_distance_m"_a,
           "occupied_log_odds"_a)
      .def("distance_slice", &distances_in_layer, "low_m"_a, "high_m"_a, "z_m"_a,
           "max_distance_m"_a, "occupied_log_odds"_a)
      .def("occupied_in", &occupied_of_region, "low_m"_a, "high_m"_a, "occupied_log_odds"_a);
}

}  // namespace mapperd::python
