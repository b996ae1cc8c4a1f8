// Points as arrays, kept alive while C++ reads them without the GIL.
#pragma once

#include <cstddef>
#include <string>

#include "arrays.hpp"
#include "mapperd/queries.hpp"
#include "mapperd/vec.hpp"

namespace mapperd::bind {

class PointArray {
 public:
  PointArray(const py::object& object, const char* name)
      : array_(checked<double>(object, name, 2)) {
    if (array_.shape(1) != 3) {
      throw std::invalid_argument(std::string(name) + " must have shape (N, 3)");
    }
  }

  py::ssize_t rows() const { return array_.shape(0); }
  Points view() const { return {array_.data(), static_cast<std::size_t>(rows())}; }

 private:
  Array<double> array_;
};

inline Array<double> numbers_of(const py::object& object, const char* name, py::ssize_t count) {
  auto array = checked<double>(object, name, 1);
  if (array.shape(0) != count) {
    throw std::invalid_argument(std::string(name) + " must have shape (" + std::to_string(count) +
                                ",)");
  }
  return array;
}

inline Vec3 vec3_of(const py::object& object, const char* name) {
  const Array<double> array = numbers_of(object, name, 3);
  return {array.at(0), array.at(1), array.at(2)};
}

inline Vec3 vec2_of(const py::object& object, const char* name) {
  const Array<double> array = numbers_of(object, name, 2);
  return {array.at(0), array.at(1), 0.0};
}

}  // namespace mapperd::bind
