// Plain values of the particle filter as Python gives and takes them.
#pragma once

#include <pybind11/pybind11.h>

#include <algorithm>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "mapperd/localization/beam_weight.hpp"
#include "mapperd/localization/estimate.hpp"
#include "mapperd/localization/motion.hpp"

namespace mapperd::python {

namespace loc = mapperd::localization;

template <typename T>
std::vector<T> vector_of(const py::object& object, const char* name) {
  const auto array = checked<T>(object, name, 1);
  return std::vector<T>(array.data(), array.data() + array.size());
}

template <typename T>
py::array_t<T> array_of(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

// (3,): x, y, yaw.
inline loc::Pose2 pose_of(const py::object& object, const char* name) {
  const auto array = checked<double>(object, name, 1);
  if (array.size() != 3) throw std::invalid_argument(std::string(name) + " must have shape (3,)");
  return {array.data()[0], array.data()[1], array.data()[2]};
}

inline py::array_t<double> array_of(const loc::Pose2& pose) {
  const double values[] = {pose.x, pose.y, pose.yaw};
  return py::array_t<double>(3, values);
}

inline loc::Matrix3 matrix_of(const py::object& object, const char* name) {
  const auto array = checked<double>(object, name, 2);
  if (array.shape(0) != 3 || array.shape(1) != 3) {
    throw std::invalid_argument(std::string(name) + " must have shape (3, 3)");
  }
  loc::Matrix3 m;
  for (std::size_t i = 0; i < 3; ++i) std::copy_n(array.data() + 3 * i, 3, m[i].begin());
  return m;
}

inline py::array_t<double> array_of(const loc::Matrix3& m) {
  py::array_t<double> array({3, 3});
  for (std::size_t i = 0; i < 3; ++i) {
    std::copy(m[i].begin(), m[i].end(), array.mutable_data() + 3 * i);
  }
  return array;
}

// (N, 3) poses with equal weights.
inline loc::Particles particles_of(const py::object& object, const char* name) {
  const auto array = checked<double>(object, name, 2);
  if (array.shape(1) != 3) {
    throw std::invalid_argument(std::string(name) + " must have shape (N, 3)");
  }
  loc::Particles particles;
  particles.resize(static_cast<std::size_t>(array.shape(0)));
  for (std::size_t i = 0; i < particles.size(); ++i) {
    const double* row = array.data() + 3 * i;
    particles.set(i, {row[0], row[1], row[2]});
  }
  return particles;
}

inline py::array_t<double> poses_of(const loc::Particles& particles) {
  py::array_t<double> array({static_cast<py::ssize_t>(particles.size()), py::ssize_t{3}});
  double* to = array.mutable_data();
  for (std::size_t i = 0; i < particles.size(); ++i) {
    *to++ = particles.x[i];
    *to++ = particles.y[i];
    *to++ = particles.yaw[i];
  }
  return array;
}

inline loc::BeamAggregation aggregation_of(const std::string& name) {
  if (name == "cube_sum") return loc::BeamAggregation::kCubeSum;
  if (name == "product") return loc::BeamAggregation::kProduct;
  throw std::invalid_argument("aggregation must be cube_sum or product, not " + name);
}

inline loc::MotionModel motion_of(const std::string& name) {
  if (name == "differential_drive") return loc::MotionModel::kDifferential;
  if (name == "omnidirectional_drive") return loc::MotionModel::kOmnidirectional;
  if (name == "stationary") return loc::MotionModel::kStationary;
  throw std::invalid_argument(
      "the motion model must be differential_drive, omnidirectional_drive or stationary, not " +
      name);
}

}  // namespace mapperd::python
