// OctoMap's files, as methods of the map.
#include <pybind11/pybind11.h>

#include <string>
#include <string_view>

#include "bindings.hpp"
#include "mapperd/map/octomap_file.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

py::bytes bt(const VoxelMap& map, double occupied_log_odds, double free_log_odds) {
  std::string file;
  {
    const py::gil_scoped_release release;
    file = octomap_bt(map, occupied_log_odds, free_log_odds);
  }
  return file;
}

py::bytes ot(const VoxelMap& map) {
  std::string file;
  {
    const py::gil_scoped_release release;
    file = octomap_ot(map);
  }
  return file;
}

// The caller holds a reference to the bytes, which cannot change.
void load_bt_or_ot(VoxelMap& map, const py::bytes& data, std::uint64_t max_voxels) {
  const std::string_view file = data;
  const py::gil_scoped_release release;
  load_octomap(file, map, max_voxels);
}

}  // namespace

void bind_octomap(py::module_& module) {
  auto map = py::class_<VoxelMap>(module.attr("VoxelMap"));
  map.def("octomap_bt", &bt, "occupied_log_odds"_a, "free_log_odds"_a)
      .def("octomap_ot", &ot)
      .def("load_octomap", &load_bt_or_ot, "data"_a, py::kw_only(),
           "max_voxels"_a = kMaxOctomapVoxels);
}

}  // namespace mapperd::python
