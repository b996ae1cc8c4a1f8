// mapperd._core: the map for Python. The public names and their documentation are in _core.pyi.
#include <pybind11/pybind11.h>

#include "bindings.hpp"
#include "mapperd/common/progress.hpp"
#include "mapperd/map/voxel_map.hpp"

PYBIND11_MODULE(_core, module) {
  module.doc() = "The C++ map core of mapperd.";
  module.attr("BLOCK_EDGE") = mapperd::map::kBlockEdge;
  module.attr("LOG_ODDS_UNIT") = mapperd::map::kLogOddsUnit;
  module.def("finished_parts", [] { return mapperd::finished_parts.load(); });
  module.def("finish_part", &mapperd::finish_part);
  mapperd::python::bind_iwlo(module);
  mapperd::python::bind_map(module);
  mapperd::python::bind_map_file(module);
  mapperd::python::bind_bricks(module);
  mapperd::python::bind_octomap(module);
  mapperd::python::bind_queries(module);
  mapperd::python::bind_point_updates(module);
  mapperd::python::bind_stream_view(module);
  mapperd::python::bind_localization_maps(module);
  mapperd::python::bind_localization_filter(module);
  mapperd::python::bind_alignment(module);
}
