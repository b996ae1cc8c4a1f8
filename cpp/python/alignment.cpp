// Registration of submaps.
#include <pybind11/pybind11.h>

#include "bindings.hpp"
#include "localization_types.hpp"
#include "mapperd/alignment/registration.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;
namespace alg = alignment;

std::vector<Vec3> centres_of(const py::object& object, const char* name) {
  const auto array = checked<double>(object, name, 2);
  if (array.shape(1) != 3) throw std::invalid_argument(std::string(name) + " must be (N, 3)");
  std::vector<Vec3> centres(static_cast<std::size_t>(array.shape(0)));
  const double* row = array.data();
  for (Vec3& centre : centres) {
    centre = {row[0], row[1], row[2]};
    row += 3;
  }
  return centres;
}

alg::Submap submap_of(const py::object& occupied, const py::object& free, double resolution_m,
                      const py::object& weights) {
  const auto solid = centres_of(occupied, "occupied_m");
  const auto empty = centres_of(free, "free_m");
  std::vector<double> values(solid.size(), 1.0);
  if (!weights.is_none()) {
    const auto array = checked<double>(weights, "weights", 1);
    values.assign(array.data(), array.data() + array.size());
  }
  const py::gil_scoped_release release;
  return alg::Submap(solid, empty, resolution_m, values);
}

py::tuple found(const alg::Candidate& candidate) {
  return py::make_tuple(array_of(candidate.pose), candidate.score, candidate.agreement.matched,
                        candidate.agreement.contradicted);
}

py::list searched(const alg::Submap& target, const alg::Submap& source, const py::object& centre,
                  double half_x_m, double half_y_m, double half_yaw_rad, double step_m,
                  double step_yaw_rad, std::size_t count) {
  const alg::SearchWindow window{
      pose_of(centre, "centre"), half_x_m, half_y_m, half_yaw_rad, step_m, step_yaw_rad};
  std::vector<alg::Candidate> best;
  {
    const py::gil_scoped_release release;
    best = alg::search_poses(target, source, window, count);
  }
  py::list list;
  for (const auto& one : best) list.append(found(one));
  return list;
}

py::tuple compared(const alg::Submap& target, const alg::Submap& source, const py::object& pose,
                   double scale_m, std::size_t points) {
  const auto at = pose_of(pose, "pose");
  alg::Candidate candidate;
  {
    const py::gil_scoped_release release;
    candidate = alg::compare_submaps(target, source, at, scale_m, points);
  }
  return found(candidate);
}

alg::Registration registered(const alg::Submap& target, const alg::Submap& source,
                             const py::object& start) {
  const auto pose = pose_of(start, "start");
  const py::gil_scoped_release release;
  return alg::register_submaps(target, source, pose);
}

}  // namespace

void bind_alignment(py::module_& module) {
  py::class_<alg::Submap>(module, "Submap")
      .def(py::init(&submap_of), "occupied_m"_a, "free_m"_a, "resolution_m"_a,
           "weights"_a = py::none())
      .def_property_readonly("occupied",
                             [](const alg::Submap& map) { return map.distributions().size(); });
  py::class_<alg::Registration>(module, "Registration")
      .def_property_readonly("pose", [](const alg::Registration& r) { return array_of(r.pose); })
      .def_property_readonly("information",
                             [](const alg::Registration& r) { return array_of(r.information); })
      .def_property_readonly("curvature",
                             [](const alg::Registration& r) { return array_of(r.curvature); })
      .def_property_readonly("score", [](const alg::Registration& r) { return r.fit.score; })
      .def_property_readonly("matched",
                             [](const alg::Registration& r) { return r.fit.agreement.matched; })
      .def_readonly("converged", &alg::Registration::converged);
  module.def("search_poses", &searched, "target"_a, "source"_a, "centre"_a, py::kw_only(),
             "half_x_m"_a, "half_y_m"_a, "half_yaw_rad"_a, "step_m"_a, "step_yaw_rad"_a, "count"_a);
  module.def("compare_submaps", &compared, "target"_a, "source"_a, "pose"_a, py::kw_only(),
             "scale_m"_a, "points"_a);
  module.def("register_submaps", &registered, "target"_a, "source"_a, "start"_a);
}

}  // namespace mapperd::python
