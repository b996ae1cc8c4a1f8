// What one ping says of the voxels of one block. Reads the fan and nothing of the map, so that any
// number of blocks can be looked at side by side.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/block.hpp"
#include "mapperd/map/fan.hpp"
#include "mapperd/map/voxel_integral.hpp"
#include "mapperd/map/voxel_lines.hpp"

namespace mapperd::map {

// A voxel is occupied when at least this part of its volume holds a return ...
inline constexpr double kOccupiedPart = 0.02;
// ... and free, without one, when more than this part was seen free.
inline constexpr double kFreePart = 0.5;

// Millions a ping at long range: single precision is as fine as the map's unit of log-odds.
struct OccupiedVoxel {
  float weight;  // mean w(I) over the occupied part
  float share;   // of the occupied part in what was seen
  std::uint16_t offset;
};

struct BlockEvidence {
  BlockKey key;  // relative to the sonar's block
  VoxelRows free{};
  std::vector<OccupiedVoxel> occupied;
  bool any_free = false;

  bool empty() const { return !any_free && occupied.empty(); }
};

class BlockLooker {
 public:
  // `offset_m` is where the sonar is, from the corner of block (0, 0, 0), in the map's axes.
  BlockLooker(const Fan& fan, const FanSettings& settings, const IwloRule& rule, double edge_m,
              const Vec3& offset_m);

  // Replaces `evidence`.
  void look(const BlockKey& local, BlockEvidence& evidence) const;

 private:
  struct Cell;  // 4 x 4 x 4 voxels

  static constexpr std::size_t kMostChanges = 16;  // from free beams to others in a cell

  Vec3 centre_of(const BlockKey& local, double x, double y, double z) const;
  void look_at_cell(const BlockKey& local, int x, int y, int z, BlockEvidence& evidence) const;
  double free_part_between(const std::array<std::size_t, kMostChanges>& change, std::size_t changes,
                           bool first_is_free, const Cube& cube) const;
  bool look_between_beams(const Cell& cell, BlockEvidence& evidence) const;
  void look_near(const Cell& cell, BlockEvidence& evidence) const;
  void look_far(const Cell& cell, BlockEvidence& evidence) const;
  void places(const Cell& cell, CellPlaces& at) const;
  Vec3 voxel_centre(const Cell& cell, int i) const;
  Cube cube_at(const Vec3& centre, SeenAxes& axes) const;
  Cube cube_in(const Cell& cell, const Vec3& centre) const;
  void settle(const Fan::Verdict& verdict, const Cube& cube, int offset,
              BlockEvidence& evidence) const;
  void decide(const Evidence& sum, int offset, BlockEvidence& evidence) const;
  Evidence exact(const Cube& cube, const FanPart& where) const;
  bool sampled(const Cube& cube, const FanPart& where, Evidence& sum) const;
  static bool may_be_free(const LineTask& task);
  int lines_for(const VoxelLines::Sample& sample, bool any_return) const;

  const Fan& fan_;
  const Kernels& kernels_;
  VoxelLines lines_;
  Aggregation aggregation_;
  double edge_m_;
  Vec3 offset_m_;
  double weight_error_;  // that a voxel's weight may have; 0: exact
};

}  // namespace mapperd::map
