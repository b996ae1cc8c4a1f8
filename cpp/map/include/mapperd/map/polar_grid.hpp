/// \file
/// \brief A ping image on a grid of range and bearing that fits the voxels: where a point lies in
/// it, and which classes of evidence a cell or a block may hold.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/kernels.hpp"

namespace mapperd::map {

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

/// Rows are uniform in range and columns in parts of a beam; the grid reaches kMarginBeams beyond
/// either side of the fan. A derived class fills codes and classes.
class PolarGrid {
 public:
  PolarGrid(const PolarGrid&) = delete;
  PolarGrid& operator=(const PolarGrid&) = delete;

  /// Range beyond which the ping holds no evidence, m.
  double reach_m() const { return reach_m_; }
  bool is_empty() const { return !(reach_m_ > 0); }
  double edge_m() const { return edge_m_; }
  double min_range_m() const { return min_range_; }
  double sin_half_aperture() const { return sin_half_; }
  double cos_half_aperture() const { return cos_half_; }
  double low_sine() const { return edge_sines_.front(); }
  double high_sine() const { return edge_sines_.back(); }

  /// Neighbouring beams differ so much in width that a cell's columns are not a linear function.
  bool is_irregular() const { return irregular_; }

  double row_pitch_m() const { return row_pitch_; }
  int subcolumns() const { return subcolumns_; }

  GridView view() const;
  /// Returns its table of bearings, and lengths in voxels; the caller adds the cells' positions.
  CellsTask cells_task() const;

  /// Classes of all that a block with its centre there may hold, within the aperture.
  std::uint8_t classes_of_block(double range_m, double sine) const;

 protected:
  /// Uses `memory` during its lifetime.
  PolarGrid(GridMemory& memory, std::vector<double> edge_sines, double edge_m, double min_range_m,
            double half_aperture_rad);
  ~PolarGrid() = default;

  void measure_beams();
  /// Sets rows and columns. \throws std::invalid_argument for more than 2^30 cells.
  void set_size(double rows, int padded_beams);
  void index_bearings();
  /// For each tile the classes near it, for cells and for blocks.
  void dilate();
  double column_of(double sine) const;
  double binned_column_of(double sine) const;

  GridMemory& memory_;
  double edge_m_;
  double min_range_;
  double sin_half_;
  double cos_half_;
  double reach_m_ = 0.0;
  double row_pitch_ = 0.0;
  double narrowest_ = 0.0;  ///< of the beams, in sine
  double widest_ = 0.0;
  int subcolumns_ = 1;
  bool irregular_ = false;
  bool averages_ = false;
  std::vector<double> edge_sines_;
  std::ptrdiff_t rows_ = 0;
  std::ptrdiff_t columns_ = 0;
  std::ptrdiff_t stride_ = 0;
  std::ptrdiff_t tile_rows_ = 0;
  std::ptrdiff_t tile_columns_ = 0;

 private:
  void dilate(float reach, std::vector<std::uint8_t>& wide) const;
  double bin_sine(std::size_t bin) const;

  double bins_per_sine_ = 0.0;
  std::vector<float> bin_column_;
  std::vector<float> bin_slope_;
};

/// Beams, rounded up to whole groups.
inline int padded_beams(std::size_t beams) {
  return (static_cast<int>(beams) + kGroupBeams - 1) / kGroupBeams * kGroupBeams;
}

}  // namespace mapperd::map
