/// \file
/// \brief A block's voxels as bytes, without loss.
///
/// The first byte is the format; a new format gets a new number:
///   1  all voxels alike, as once written: units of 2^-24 i32, count u16;
///   2  one by one, as once written: 512 bytes with a bit for each voxel that was observed (voxel i
///   is
///      bit i % 8 of byte i / 8, x fastest), then the units i32 of those, then their counts u16;
///   3  all voxels alike: shift u8, units of 2^-shift i16, count u16;
///   4  cell by cell, counts of one byte: shift u8, a bit for each cell whose voxels are alike and
///      observed u64, a bit for each other cell with observed voxels u64; then the cells in order:
///      units i16 and count u16, or the units i16 of 64 voxels and their counts, 0 if not observed;
///   5  the same with counts of two bytes.
/// This version writes 3, 4 and 5. All numbers are little endian. The bytes depend on the voxels
/// alone, not on how they are held: equal blocks are equal bytes.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <array>
#include <string>

#include "mapperd/map/block.hpp"
#include "mapperd/map/bytes.hpp"
#include "mapperd/map/iwlo.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Appends the voxels of a block that has observed ones.
void encode_block(const VoxelMap& map, const Block& block, std::string& out);

/// Reads what encode_block() wrote. Voxels that were never observed have count 0.
/// \throws std::invalid_argument, with the place, for anything but a block's voxels inside the
/// rule's clamps and settled count.
void decode_block(ByteReader& bytes, const IwloRule& rule, BlockStates& states);

}  // namespace mapperd::map
