// Points as arrays, kept alive while C++ reads them without the GIL.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "mapperd/common/vec.hpp"
#include "mapperd/map/queries.hpp"

namespace mapperd::python {

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

// Centres (N, 3), log-odds (N,) and counts (N,).
inline py::tuple arrays_of(const VoxelMap& map, const std::vector<KnownVoxel>& voxels) {
  const auto n = static_cast<py::ssize_t>(voxels.size());
  py::array_t<double> centres({n, py::ssize_t{3}});
  py::array_t<float> log_odds(n);
  py::array_t<std::uint16_t> counts(n);
  double* centre = centres.mutable_data();
  float* value = log_odds.mutable_data();
  std::uint16_t* count = counts.mutable_data();
  for (const KnownVoxel& known : voxels) {
    const Vec3 at = map.centre_of(known.voxel);
    for (const double coordinate : {at.x, at.y, at.z}) *centre++ = coordinate;
    *value++ = known.state.log_odds;
    *count++ = known.state.count;
  }
  return py::make_tuple(centres, log_odds, counts);
}

}  // namespace mapperd::python
