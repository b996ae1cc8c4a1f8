/// \file
/// \brief Evidence of one ping as an image in range and sine of bearing, in which each voxel is
/// looked up once.
///
/// The definition. Around a point at range r and sine s of the bearing lies a footprint: in range
/// [r - a, r + a] with a = 0.54 voxel edges, and in sine [s - b, s + b] with b = a cos(bearing) /
/// r. Let N be the share of the footprint that holds a return, W the integral of w(I) over that
/// share, and F the share that is free: between min_range and the first return of its beam. The
/// point is
///
///   occupied with weight W / N  where N >= 0.02,
///   free                        elsewhere where F > 0.5,
///   unknown                     elsewhere.
///
/// A voxel's evidence is that of its centre, if the centre lies inside the vertical aperture; an
/// occupied one's centre may lie outside by half an edge. 0.54: the plane that cuts off 2 % of a
/// cube's volume lies 0.48 to 0.58 edges from its centre, whatever the plane's direction.
///
/// The grid holds the definition's values at points: rows every 0.3 edges or less, columns every
/// 0.5 edges at max_range or less, both divided by `detail`. A voxel takes the value of the nearest
/// point. cos(bearing) is that of the middle of each group of eight beams, whose beams count as
/// equally wide. The grid ends eight beams beside the fan.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/iwlo.hpp"
#include "mapperd/map/kernels.hpp"
#include "mapperd/map/ping.hpp"
#include "mapperd/map/ping_motion.hpp"
#include "mapperd/map/polar_grid.hpp"

namespace mapperd::map {

inline constexpr double kFootprintReach = 0.54;  ///< in voxel edges, each way
inline constexpr double kOccupiedShare = 0.02;
inline constexpr double kFreeShare = 0.5;
inline constexpr double kOccupiedSlack = 0.5;  ///< beyond the aperture's faces, in voxel edges

/// A ping's image, filtered with the footprint of a voxel: one look-up gives a voxel's evidence.
class EvidenceGrid : public PolarGrid {
 public:
  /// Uses `memory` during its lifetime.
  EvidenceGrid(GridMemory& memory, const PingImage& image, const PingParams& settings,
               const IwloRule& rule, double edge_m);

  bool averages() const { return averages_; }

  /// Evidence of a point of the sonar frame, in metres.
  struct Evidence {
    std::uint8_t code = kCodeNothing;
    std::uint8_t share = 0;
  };
  Evidence at(const Vec3& in_sonar) const;
  /// Evidence of each of a cell's points, bit-exactly as the above.
  CodeCounts at(const CellPoints& in_sonar, std::uint8_t* codes, std::uint8_t* shares) const;

 private:
  struct Sums;  ///< of returns along range

  /// Of a point: how far, in voxels, it lies inside the aperture's faces, and its place in the
  /// grid.
  struct SamplePlace {
    double inside, row, sine;
  };
  SamplePlace place_of(const Vec3& in_sonar) const;
  Evidence at(const Vec3& in_sonar, const SamplePlace& place) const;

  void choose_pitch(const PingImage& image, double detail);
  void sum_returns(const PingImage& image, const IwloRule& rule, bool carve_no_return, Sums& sums);
  void fill(const PingImage& image, const Sums& sums, int threads);
};

}  // namespace mapperd::map
