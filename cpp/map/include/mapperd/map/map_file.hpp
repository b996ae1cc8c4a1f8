/// \file
/// \brief A whole map as bytes, without loss: a loaded map continues bit-exactly as the saved one.
///
/// Little endian: "mapperd\n", version u32, resolution f64, clamps in units i32 and i32, in version
/// 2 the prior in units i32, settled count u16, number of blocks u64; then for each block its key
/// 3 x i32 and its voxels (block_codec.hpp), in ascending order of the keys; CRC-32 u32 of all
/// bytes in front of it. Maps with a prior of 0 are version 1. Clamps and voxels are evidence, to
/// which the prior is added. Equal maps are equal files, however their blocks are held and whenever
/// they were made.
///
/// \par Threads
/// Each function locks the map itself: any thread may call it without holding a lock of the map.
#pragma once

#include <string>
#include <string_view>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

inline constexpr std::string_view kMapFileMagic = "mapperd\n";

std::string encode_map(const VoxelMap& map);

/// Replaces the map's content by that of a file. All blocks count as changed.
/// \throws std::invalid_argument, with the reason, for anything but a whole file of a map of
/// the same resolution, prior, clamps and settled count; the map is then as before. A file takes at
/// most fifty times its size as a map.
void load_map(std::string_view file, VoxelMap& map);

}  // namespace mapperd::map
