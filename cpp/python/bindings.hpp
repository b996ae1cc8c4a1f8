// One function a file of bindings; module.cpp calls them in turn.
#pragma once

#include <pybind11/pybind11.h>

namespace mapperd::map {}

namespace mapperd::python {

namespace py = pybind11;
using namespace map;

void bind_iwlo(py::module_& module);
void bind_map(py::module_& module);
void bind_map_file(py::module_& module);       // after bind_map
void bind_bricks(py::module_& module);         // after bind_map
void bind_octomap(py::module_& module);        // after bind_map
void bind_queries(py::module_& module);        // after bind_map
void bind_point_updates(py::module_& module);  // after bind_map
void bind_stream_view(py::module_& module);    // after bind_map
void bind_localization_maps(py::module_& module);
void bind_localization_filter(py::module_& module);  // after bind_localization_maps
void bind_alignment(py::module_& module);

}  // namespace mapperd::python
