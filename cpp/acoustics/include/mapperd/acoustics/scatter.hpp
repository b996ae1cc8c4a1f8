/// \file
/// \brief Echo of a ping's surfaces over range and bearing: the complex field, or its mean power.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>

#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

/// Pose of transmitter or receiver in the frame of the insonified object. The mirror image of the
/// sonar is a leg with a reflecting rotation.
struct Leg {
  Vec3 origin_m;
  std::array<double, 9> rotation;  ///< object from sonar, row by row; sonar x ahead, y port, z up
  Vec3 drift_m;                    ///< apparent range grows by this times the direction to the echo
  double gain;                     ///< of pressure, signed
};

/// How a surface scatters sound.
struct Material {
  double mu;                ///< Lambert's coefficient
  double reflection_power;  ///< squared coefficient of reflection
  double roughness_m;       ///< standard deviation of the height below a wavelength's scale
  double slope_rad;         ///< standard deviation of the slope
};

/// A triangle, as its plane n.p = offset in the frame of its object. Hits lie anywhere in the table
/// of faces: all that they need is in one line of the cache.
struct alignas(64) Face {
  double plane[4];        ///< n, offset
  double turn_per_m;      ///< by which a round surface's normal turns at most, rad/m
  std::uint32_t object;   ///< key
  std::int32_t material;  ///< index
  std::int32_t smooth;    ///< index into curved_normal, or -1
};

struct Faces {
  const Face* table;
  const double* curved_normal;  ///< (S, 12): normal of a round surface at p is G p + g, rows of G|g
  const Material* materials;
};

/// Hits of the rays. Each covers a cell of directions, in the frame of the leg that saw it.
struct RayHits {
  std::size_t count;
  const std::int32_t* face;      ///< negative: no echo
  const std::int32_t* seen;      ///< leg that looked
  const std::int32_t* transmit;  ///< leg
  const std::int32_t* receive;   ///< leg
  const float* cell;             ///< (count, 4): s from, s to, w from, w to
  const float* span_m;           ///< (count, 2): ranges between which the face's plane is followed
  const float* gain;             ///< of pressure
  const Leg* legs;
  bool both_ways;  ///< the sound goes there by `receive` and back by `transmit` too; no leg drifts
  const float* lean = nullptr;  ///< (count, 2): by which a cell's s grows with w from its middle,
                                ///< or its w with s; null: all are upright
};

/// Rows of range, columns of bearing.
struct EchoGrid {
  std::ptrdiff_t rows;
  std::ptrdiff_t columns;
  double row_m;
  double first_sine;  ///< of the bearing of column 0
  double sine_pitch;
  double range_scale;  ///< apparent range over true range
};

/// Weights of the receiver.
struct EchoResponse {
  const float* loss;      ///< (rows,): pressure that the way to a row and back leaves
  const float* vertical;  ///< (vertical_count,): one-way pressure over |w| from 0 to 1
  std::size_t vertical_count;
  const float* taps;  ///< (fractions, tap_count): spreads an echo between columns over whole ones
  std::size_t fractions;
  std::size_t tap_count;
};

/// Parts of the model of scattering, and its random scatterers.
struct ScatterModel {
  bool lambert;           ///< diffuse echoes fall with both cosines; otherwise they do not
  bool specular;          ///< round the mirror's direction a rough surface has a lobe
  bool spreading;         ///< pressure falls with the range, out and back
  double turns_per_m;     ///< of phase: 1 / wavelength
  double nodes_per_cell;  ///< scatterers per cell of row and column
  std::uint64_t key;      ///< of the random numbers
};

/// All that the echo of a ping depends on; borrowed, not copied.
struct ScatterInput {
  Faces faces;
  RayHits hits;
  EchoGrid grid;
  EchoResponse response;
  ScatterModel model;
};

/// Adds the pressure of random scatterers on the surfaces to a complex field (rows, columns).
void scatter_field(const ScatterInput& echoes, std::complex<float>* field, int threads);

/// Adds the surfaces' mean power to a field (rows, columns).
void scatter_power(const ScatterInput& echoes, float* power, int threads);

}  // namespace mapperd::acoustics
