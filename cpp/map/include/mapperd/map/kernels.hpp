/// \file
/// \brief The inner loops of the evidence grid, compiled for any machine and, on x86, for AVX2 as
/// well. All do the same operations in the same order, lane by lane, and so give the same bits.
///
/// They see plain data only. Inline functions of the standard library compiled with AVX2 could be
/// the copies that the linker keeps for the whole program, and crash it on older machines.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::map {

/// Evidence of a ping for one voxel, as a byte: none, free, or a return of some weight.
inline constexpr std::uint8_t kCodeNothing = 0;
inline constexpr std::uint8_t kCodeFree = 1;
inline constexpr std::uint8_t kCodeOccupied = 2;  ///< the smallest weight; 255 is the largest

/// The update rule in whole units of log-odds (iwlo.hpp).
struct RuleTables {
  const std::int16_t* alpha;           ///< by count, Q15
  const std::int16_t* occupied_scale;  ///< by units - min_units, Q15
  const std::int16_t* free_scale;
  float decay_rate;  ///< alpha = max(min_alpha, 1 / (1 + decay_rate n)), as in `alpha`
  float min_alpha;
  std::int16_t occupied_unscaled_from;
  std::int16_t unscaled_up_to;
  std::int16_t min_ratio;
  std::int16_t max_ratio;
  std::int16_t code_base;
  std::int16_t code_slope;
  std::int16_t full_free;
  std::int16_t min_units;
  std::int16_t max_units;
  std::uint16_t settled_count;
};

/// Beams that share one width of the footprint.
inline constexpr int kGroupBeams = 8;

/// The grid reaches so many beams beyond either side of the fan, as the footprints of its outermost
/// beams do.
inline constexpr int kMarginBeams = kGroupBeams;
inline constexpr int kMaxSubcolumns = 4096;

/// Tiles of the grid that class masks stand for.
inline constexpr int kTileRows = 4;
inline constexpr int kTileColumns = 4;

/// Classes of evidence, as bits of a mask.
inline constexpr std::uint8_t kHasNothing = 1;
inline constexpr std::uint8_t kHasFree = 2;
inline constexpr std::uint8_t kHasOccupied = 4;

/// Input and output of build_rows(). Arrays by beam have `beams` entries, a multiple of
/// kGroupBeams; beams beyond those of the ping hold no evidence.
struct GridTask {
  int beams;
  int subcolumns;   ///< columns a beam
  float subcolumn;  ///< one of them, in beams
  int ping_rows;
  float row_pitch;        ///< m
  float half_window;      ///< m, of the footprint along range
  float rows_per_m;       ///< of the ping
  float min_range;        ///< m
  const float* counted;   ///< [row][beam] returns in the rows before
  const float* weighted;  ///< and the sum of their weights, from 0 to 1
  const float* free_end;  ///< by beam: free up to here, m
  const float* width;     ///< by group: half the footprint in beams, times range in m
  float min_occupied;     ///< share of the footprint
  float min_free;
  std::uint8_t* codes;    ///< [row][column]
  std::uint8_t* shares;   ///< null unless evidence is averaged
  std::uint8_t* classes;  ///< [tile row][tile column]
  std::ptrdiff_t stride;  ///< columns of a row in memory
  std::ptrdiff_t tile_stride;
};

/// Memory for one row: see scratch_floats().
std::size_t scratch_floats(const GridTask& task);

/// The evidence grid, as the kernels read it.
struct GridView {
  const std::uint8_t* codes;
  const std::uint8_t* shares;
  const std::uint8_t* cell_classes;  ///< [tile row][tile column], of all that a cell there may hold
  std::int32_t stride;
  std::int32_t tile_stride;
  float rows;
  float columns;
};

/// Input for the grid coordinates of a block's cells. Lengths in voxels, in the sonar frame.
struct CellsTask {
  float first[3];    ///< centre of the first cell
  float step[3][3];  ///< from cell to cell along the map's x, y, z
  float voxel_step[3][3];
  float sin_half_aperture;
  float cos_half_aperture;
  float rows_per_voxel;
  float sine_low;  ///< of the first bin of the bearing table
  float bins_per_sine;
  float last_bin;
  const float* bin_column;  ///< column = bin_column + bin_slope * sine
  const float* bin_slope;
  float reach;  ///< of a cell's voxels from its centre
};

/// Evidence that a cell may hold, as bits kHas...; 0 for none.
inline constexpr std::uint8_t kCutByAperture = 8;
inline constexpr std::uint8_t kNearAxis = 16;  ///< behind or beside the sonar for some voxels

/// The cells of a block in the grid. Rows, columns and the distances to the aperture's faces are
/// linear functions of a voxel's place in its cell: the first voxel's, and a step along each axis
/// of the map. Nothing but `classes` is set where no cell is mixed.
struct CellPlaces {
  std::uint8_t classes[64];
  bool within[64];  ///< all voxels lie inside the grid
  float range[64];  ///< voxels
  float row[64], row_step[3][64];
  float column[64], column_step[3][64];
  /// Inside the aperture where |height| < spread, in voxels.
  float spread[64], spread_step[3][64];
  float height[64];
};

/// Voxels of a cell with evidence of each kind.
struct CodeCounts {
  int occupied;
  int free;
};

/// The inner loops, for one instruction set of the processor.
struct Kernels {
  const char* name;
  void (*build_rows)(const GridTask& task, int first, int end, float* scratch);
  void (*place_cells)(const CellsTask& task, const GridView& grid, CellPlaces& places);
  /// Writes the codes of a cell's voxels, and their shares if the grid has them.
  CodeCounts (*look_up)(const CellsTask& task, const GridView& grid, const CellPlaces& places,
                        int cell, std::uint8_t* codes, std::uint8_t* shares);
  /// Updates a cell's voxels by their codes; with `shares`, evidence of both kinds is averaged.
  /// False when nothing changed.
  bool (*apply)(const RuleTables& rule, const std::uint8_t* codes, const std::uint8_t* shares,
                std::int16_t* units, std::byte* counts, int count_bytes);
};

/// The fastest kernels that this machine runs, and the portable ones.
const Kernels& kernels();
const Kernels& plain_kernels();

}  // namespace mapperd::map
