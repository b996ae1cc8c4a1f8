/// \file
/// \brief OctoMap's tree files (.bt and .ot), written from the map and read into it without a
/// second tree in between.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

// Both writers prune eight equal children to one leaf, at all levels. OctoMap does so before it
// writes a .bt; its .ot holds the tree as it stands in memory, which is pruned unless updates were
// lazy, and its readers take both.
// Both throw std::out_of_range, naming the voxel, where OctoMap's 16-bit keys do not reach.

/// Encodes a .bt file: occupied above `occupied_log_odds`, free below `free_log_odds`, else
/// unknown.
std::string octomap_bt(const VoxelMap& map, double occupied_log_odds, double free_log_odds);

/// Encodes a .ot file: every observed voxel with its log-odds; the format has no counts. OctoMap
/// itself calls a voxel occupied from log-odds 0 on. An empty map is a tree of size 0, as OctoMap
/// writes it. OctoMap 1.10 does not look at the size when it reads a .ot and then takes bytes that
/// are not there: do not hand it an empty one.
std::string octomap_ot(const VoxelMap& map);

/// Default limit of load_octomap(): 33 500 m3 at 5 cm, 0.9 GB if every cell is mixed.
inline constexpr std::uint64_t kMaxOctomapVoxels = std::uint64_t{1} << 28U;

/// Replaces the map's content by that of a .bt or .ot file; leaves above the finest level become
/// voxels.
///
/// The format has no observation counts: every count becomes 1.
/// Values of a .ot are clamped to the map's L_min and L_max. A .bt has classes only; free and
/// occupied become OctoMap's default clamps, -2 and 3.5, within L_min and L_max: beyond the usual
/// thresholds, and still changeable by the next pings. Values of inner nodes are ignored, as in
/// OctoMap.
///
/// A small file can stand for a vast map. `max_voxels` limits the memory: it counts all voxels of
/// each cube of 16^3 that the tree touches.
///
/// \throws std::invalid_argument, naming what is wrong and at which byte, for anything but a whole
/// tree of the map's own resolution; the map is then as before. (Where memory runs out in spite of
/// the limit, it is empty.)
void load_octomap(std::string_view file, VoxelMap& map,
                  std::uint64_t max_voxels = kMaxOctomapVoxels);

}  // namespace mapperd::map
