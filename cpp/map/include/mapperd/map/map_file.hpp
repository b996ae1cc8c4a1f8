// A whole map as one run of bytes, without loss: what is loaded goes on as what was saved.
//
// Little endian: "mapperd\n", version u32 = 1, resolution f64, clamps in units i32 and i32, settled
// count u16, number of blocks u64; then for each block its key 3 x i32 and its voxels
// (block_codec.hpp), in ascending order of the keys; CRC-32 u32 of all bytes in front of it. Equal
// maps are equal files, however their blocks are held and whenever they were made.
#pragma once

#include <string>
#include <string_view>

#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

inline constexpr std::string_view kMapFileMagic = "mapperd\n";

std::string encode_map(const VoxelMap& map);

// Makes the map's content that of a file. All blocks count as changed.
// Throws std::invalid_argument, saying what is wrong, for anything but a whole file of a map of the
// same resolution, clamps and settled count; the map is then as before. A file takes at most fifty
// times its size as a map.
void load_map(std::string_view file, VoxelMap& map);

}  // namespace mapperd::map
