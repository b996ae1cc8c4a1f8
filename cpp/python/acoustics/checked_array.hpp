// What the bindings that take tables of faces or poses share.
#pragma once

#include <pybind11/numpy.h>

#include <stdexcept>

#include "mapperd/common/vec.hpp"

template <typename T>
using Array = pybind11::array_t<T, pybind11::array::c_style>;

inline void require(bool holds, const char* what) {
  if (!holds) {
    throw std::invalid_argument(what);
  }
}

// Of twelve numbers: the rotation, row by row, and the position.
inline mapperd::Transform transform_of(const double* m) {
  return {{mapperd::Vec3{m[0], m[1], m[2]}, mapperd::Vec3{m[3], m[4], m[5]},
           mapperd::Vec3{m[6], m[7], m[8]}},
          {m[9], m[10], m[11]}};
}
