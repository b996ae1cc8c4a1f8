/// \file
/// \brief Fixed-size geometry in double precision: a vector and a rigid transform, nothing more.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace mapperd {

/// A vector of three coordinates, of any unit.
struct Vec3 {
  double x = 0.0;
  double y = 0.0;
  double z = 0.0;

  /// Coordinate along axis 0, 1 or 2.
  double operator[](std::size_t axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
  double& operator[](std::size_t axis) { return axis == 0 ? x : axis == 1 ? y : z; }
};

inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(double k, const Vec3& a) { return {k * a.x, k * a.y, k * a.z}; }
inline double dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
/// Dot product of three consecutive floats, as in a table of normals.
inline float dot3(const float* a, const float* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline double norm(const Vec3& a) { return std::sqrt(dot(a, a)); }

/// a_T_b: takes coordinates in frame b to frame a.
struct Transform {
  std::array<Vec3, 3> rows{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}};  ///< of the rotation
  Vec3 translation;

  Vec3 rotate(const Vec3& v) const { return {dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)}; }
  Vec3 rotate_back(const Vec3& v) const { return v.x * rows[0] + (v.y * rows[1] + v.z * rows[2]); }
  Vec3 apply(const Vec3& v) const { return rotate(v) + translation; }
};

}  // namespace mapperd
