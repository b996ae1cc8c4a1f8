// A block's voxels as bytes, without loss.
//
// The first byte says how they are written; another way would get another number:
//   1  all voxels alike: units i32, count u16;
//   2  one by one: 512 bytes with a bit for each voxel that was observed (voxel i is bit i % 8 of
//      byte i / 8), then the units i32 of those, then their counts u16.
// All numbers are little endian. The bytes depend on the voxels alone, not on how they are held:
// equal blocks are equal bytes.
#pragma once

#include <string>

#include "mapperd/map/block.hpp"
#include "mapperd/map/bytes.hpp"
#include "mapperd/map/iwlo.hpp"

namespace mapperd::map {

// Appends the voxels of a block that has observed ones.
void encode_block(const Block& block, const IwloRule& rule, std::string& out);

// Reads what encode_block() wrote, into a block, whatever it held.
// Throws std::invalid_argument, with the place, for anything but a block's voxels inside the rule's
// clamps and settled count. The block is then as before.
void decode_block(ByteReader& bytes, const IwloRule& rule, Block& block);

}  // namespace mapperd::map
