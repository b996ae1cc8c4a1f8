// The inner loops, compiled twice: for any machine, and for AVX2. Both do the same operations in
// the same order, lane by lane, and so give the same bits.
//
// They see plain data only. Inline functions of the standard library compiled with AVX2 could be
// the copies that the linker keeps for the whole program, and crash it on older machines.
#pragma once

#include <cstdint>

namespace mapperd::map {

inline constexpr int kLanes = 8;
inline constexpr int kMaxBeamsOfVoxel = 128;
inline constexpr int kMaxRowsOfVoxel = 64;

// The direction of a plane, over the lines of a voxel: positive on the inner side at
// base + u * (line's u) + v * (line's v) + t * (place along the line).
struct LinePlane {
  float u;
  float v;
  float t;
  float minus_inverse_t;
};

// One beam where it passes a voxel.
struct LineBeam {
  const float* weight;    // w(I) of the voxel's rows
  std::uint64_t returns;  // those with a return, the first row in the lowest bit
  float free_row;         // free up to here, in rows from the voxel's first
};

// A voxel as seen along parallel lines through it. Lengths in metres; range in rows of the image,
// counted from the first row that the voxel touches.
struct LineTask {
  float half;  // half the voxel's edge
  float row;   // of the centre
  float rows_per_m;
  float ahead_u;  // direction of increasing range
  float ahead_v;
  float ahead_t;  // along the lines, positive
  float inverse_range;
  float min_row;  // nothing is learnt before it
  int beams;
  bool any_return;      // in these rows and beams
  bool outermost_low;   // the first beam is the fan's first: its lower edge counts
  bool outermost_high;  // and the last beam's upper edge
  int cones;            // planes of the aperture that cut the voxel
  LinePlane cone[2];
  float cone_base[2];
  const LinePlane* edge;  // of the beams, one more than there are; positive to larger bearings
  float edge_base[kMaxBeamsOfVoxel + 1];
  LineBeam beam[kMaxBeamsOfVoxel];
  LinePlane seen_edge[kMaxBeamsOfVoxel + 1];  // where a moving sonar's `edge` lies
};

struct LineSums {
  float occupied;  // lengths of lines, in metres
  float weighted;
  float squared;  // integral of the squared weight
  float free;
};

// Voxels of a cell, 4 along each edge, x fastest.
inline constexpr int kCellEdge = 4;
inline constexpr int kCellVoxels = kCellEdge * kCellEdge * kCellEdge;

// A linear function of a voxel's place in its cell: first + x * step[0] + y * step[1] + z *
// step[2].
struct CellLine {
  double first;
  double step[3];
};

struct CellTask {
  CellLine ahead;  // the centres' coordinates in the sonar's frame
  CellLine port;
  CellLine up;
  CellLine low_side;  // distance inside the fan's outermost edges
  CellLine high_side;
  double sin_half_aperture;
  double cos_half_aperture;
};

// Where the voxels' centres lie, seen from the sonar.
struct CellPlaces {
  double range[kCellVoxels];
  double horizontal[kCellVoxels];  // distance from the sonar's vertical axis
  double sine[kCellVoxels];        // of the bearing
  double inside_aperture[kCellVoxels];
  double inside_sides[kCellVoxels];
};

struct Lowered {
  bool any_above;  // voxels that were skipped because of the limit
  bool changed;
};

struct Kernels {
  const char* name;
  // Sums over 8 * `chunks` lines, at u and v times the voxel's edge.
  LineSums (*lines)(const LineTask& task, const float* u, const float* v, int chunks);
  void (*places)(const CellTask& task, CellPlaces& places);
  // Free steps of voxels: `down` (units, positive) and `next` (the new count) by count. Skips
  // voxels whose bit in `rows` (16 voxels a row) is not set, and those above `limit`.
  Lowered (*lower)(std::int32_t* units, std::uint16_t* count, const std::uint16_t* rows,
                   const std::uint32_t* down, const std::uint32_t* next, std::int32_t min_units,
                   std::int32_t limit);
};

// The fastest that this machine runs, and the plain ones.
const Kernels& kernels();
const Kernels& plain_kernels();

}  // namespace mapperd::map
