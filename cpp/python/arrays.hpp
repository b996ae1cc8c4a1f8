// NumPy arrays in and out, with shape checks that name the argument.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cmath>
#include <initializer_list>
#include <stdexcept>
#include <string>

#include "mapperd/common/vec.hpp"

namespace mapperd::python {

namespace py = pybind11;

// forcecast is off: a float64 image or a float32 pose is a mistake, not a thing to convert.
template <typename T>
using Array = py::array_t<T, py::array::c_style>;

template <typename T>
Array<T> checked(const py::object& object, const char* name, int dimensions) {
  if (!py::isinstance<Array<T>>(object)) {
    throw std::invalid_argument(std::string(name) + " must be a C-contiguous array of dtype " +
                                std::string(py::str(py::dtype::of<T>())));
  }
  auto array = py::reinterpret_borrow<Array<T>>(object);
  if (array.ndim() != dimensions) {
    throw std::invalid_argument(std::string(name) + " must have " + std::to_string(dimensions) +
                                " dimensions, not " + std::to_string(array.ndim()));
  }
  return array;
}

// A 4x4 homogeneous matrix. The rotation's rows are checked by the integrators.
inline Transform transform_of(const py::object& object, const char* name) {
  const auto m = checked<double>(object, name, 2);
  if (m.shape(0) != 4 || m.shape(1) != 4) {
    throw std::invalid_argument(std::string(name) + " must have shape (4, 4)");
  }
  const auto a = m.unchecked<2>();
  const bool last_row = a(3, 0) == 0 && a(3, 1) == 0 && a(3, 2) == 0 && a(3, 3) == 1;
  if (!last_row) throw std::invalid_argument(std::string(name) + ": last row must be 0 0 0 1");
  Transform t;
  for (int i = 0; i < 3; ++i) {
    t.rows[static_cast<std::size_t>(i)] = {a(i, 0), a(i, 1), a(i, 2)};
  }
  t.translation = {a(0, 3), a(1, 3), a(2, 3)};
  return t;
}

}  // namespace mapperd::python
