// Whole maps as bytes, as methods of VoxelMap.
#include "mapperd/map/map_file.hpp"

#include <pybind11/pybind11.h>

#include <string>
#include <string_view>

#include "bindings.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

py::bytes encode(const VoxelMap& map) {
  std::string file;
  {
    const py::gil_scoped_release release;
    file = encode_map(map);
  }
  return file;
}

// The caller holds a reference to the bytes, which cannot change.
void load(VoxelMap& map, const py::bytes& data) {
  const std::string_view file = data;
  const py::gil_scoped_release release;
  load_map(file, map);
}

}  // namespace

void bind_map_file(py::module_& module) {
  module.attr("MAP_FILE_MAGIC") = py::bytes(kMapFileMagic.data(), kMapFileMagic.size());
  static_cast<py::class_<VoxelMap>>(module.attr("VoxelMap"))
      .def("encode_map", &encode)
      .def("load_map", &load, "data"_a);
}

}  // namespace mapperd::python
