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

namespace mapperd::map {

inline constexpr double kFootprintReach = 0.54;  ///< in voxel edges, each way
inline constexpr double kOccupiedShare = 0.02;
inline constexpr double kFreeShare = 0.5;
inline constexpr double kOccupiedSlack = 0.5;  ///< beyond the aperture's faces, in voxel edges

/// How far the voxels of a cell and of a block lie from its centre, in voxel edges, with a
/// hundredth of room for rounding and motion.
inline constexpr float kCellReach = 2.65F;    ///< 1.5 sqrt(3)
inline constexpr float kBlockReach = 13.25F;  ///< 7.5 sqrt(3)

/// Memory of a grid, reused for the next grid of the same thread: a grid takes megabytes, which the
/// system would otherwise clear for each ping.
struct GridMemory {
  std::vector<float> counted;
  std::vector<float> weighted;
  std::vector<std::uint8_t> codes;
  std::vector<std::uint8_t> shares;
  std::vector<std::uint8_t> classes;
  std::vector<std::uint8_t> cell_classes;
  std::vector<std::uint8_t> block_classes;
};

class EvidenceGrid {
 public:
  /// Uses `memory` during its lifetime.
  EvidenceGrid(GridMemory& memory, const PingImage& image, const PingParams& settings,
               const IwloRule& rule, double edge_m);
  EvidenceGrid(const EvidenceGrid&) = delete;
  EvidenceGrid& operator=(const EvidenceGrid&) = delete;

  /// Range beyond which the ping holds no evidence, m.
  double reach_m() const { return reach_m_; }
  bool is_empty() const { return !(reach_m_ > 0); }
  double edge_m() const { return edge_m_; }
  double min_range_m() const { return min_range_; }
  double sin_half_aperture() const { return sin_half_; }
  double cos_half_aperture() const { return cos_half_; }
  double low_sine() const { return edge_sines_.front(); }
  double high_sine() const { return edge_sines_.back(); }
  bool averages() const { return averages_; }

  /// Neighbouring beams differ so much in width that a cell's columns are not a linear function.
  bool is_irregular() const { return irregular_; }

  GridView view() const;
  /// Returns its table of bearings, and lengths in voxels; the caller adds the cells' positions.
  CellsTask cells_task() const;

  /// Evidence of a point of the sonar frame, in metres.
  struct Evidence {
    std::uint8_t code = kCodeNothing;
    std::uint8_t share = 0;
  };
  Evidence at(const Vec3& in_sonar) const;
  /// Evidence of each of a cell's points, bit-exactly as the above.
  CodeCounts at(const CellPoints& in_sonar, std::uint8_t* codes, std::uint8_t* shares) const;

  /// Classes of all that a block with its centre there may hold, within the aperture.
  std::uint8_t classes_of_block(double range_m, double sine) const;

  double row_pitch_m() const { return row_pitch_; }
  int subcolumns() const { return subcolumns_; }

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
  void index_bearings();
  void sum_returns(const PingImage& image, const IwloRule& rule, bool carve_no_return, Sums& sums);
  void fill(const PingImage& image, const Sums& sums, int threads);
  void dilate(float reach, std::vector<std::uint8_t>& wide) const;
  double column_of(double sine) const;
  double binned_column_of(double sine) const;
  double bin_sine(std::size_t bin) const;

  GridMemory& memory_;
  double edge_m_;
  double min_range_;
  double sin_half_;
  double cos_half_;
  double reach_m_ = 0.0;
  double row_pitch_ = 0.0;
  double narrowest_ = 0.0;  ///< of the beams, in sine
  int subcolumns_ = 1;
  bool irregular_ = false;
  bool averages_ = false;
  std::vector<double> edge_sines_;
  double bins_per_sine_ = 0.0;
  std::vector<float> bin_column_;
  std::vector<float> bin_slope_;
  std::ptrdiff_t rows_ = 0;
  std::ptrdiff_t columns_ = 0;
  std::ptrdiff_t stride_ = 0;
  std::ptrdiff_t tile_rows_ = 0;
  std::ptrdiff_t tile_columns_ = 0;
};

}  // namespace mapperd::map
