#include "mapperd/map/brick.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "mapperd/map/block_codec.hpp"
#include "mapperd/map/bytes.hpp"

namespace mapperd::map {
namespace {

BlockKey block_at(const BlockKey& brick, int place) {
  const auto index = [](std::int32_t i, int local) { return i * kBrickEdge + local; };
  return {index(brick.x, place % kBrickEdge), index(brick.y, place / kBrickEdge % kBrickEdge),
          index(brick.z, place / (kBrickEdge * kBrickEdge))};
}

Brick encoded(const VoxelMap& map, const BlockKey& key) {
  Brick brick{key, 0, {}};
  put(brick.bytes, std::uint8_t{0});
  std::uint8_t blocks = 0;
  for (int place = 0; place < kBrickBlocks; ++place) {
    const Block* block = map.find(block_at(key, place));
    if (block == nullptr) continue;
    brick.revision = std::max(brick.revision, block->revision);
    if (block->known_count(map.pool()) == 0) continue;
    put(brick.bytes, static_cast<std::uint8_t>(place));
    put(brick.bytes, block->revision);
    encode_block(map, *block, brick.bytes);
    ++blocks;
  }
  brick.bytes[0] = static_cast<char>(blocks);
  return brick;
}

struct DecodedBlock {
  BlockKey key;
  std::uint64_t revision = 0;
  BlockStates states;
};

std::vector<DecodedBlock> decoded(const BrickView& brick, const IwloRule& rule) {
  std::vector<DecodedBlock> blocks;
  ByteReader bytes(brick.bytes);
  const int count = bytes.get<std::uint8_t>();
  int last = -1;
  for (int i = 0; i < count; ++i) {
    const int place = bytes.get<std::uint8_t>();
    if (place <= last || place >= kBrickBlocks) bytes.refuse("a block out of order");
    last = place;
    DecodedBlock block{block_at(brick.key, place), 0, {}};
    if (!in_reach(block.key)) bytes.refuse("a block beyond the map's reach");
    block.revision = bytes.get<std::uint64_t>();
    decode_block(bytes, rule, block.states);
    blocks.push_back(block);
  }
  if (bytes.left() != 0) bytes.refuse("bytes follow the last block");
  return blocks;
}

// Bricks that reach beyond what 32 bits hold of their blocks hold nothing of the map.
void check_key(const BlockKey& brick) {
  const auto ok = [](std::int32_t i) {
    return i >= -(kMaxBlock >> kBrickShift) && i <= kMaxBlock >> kBrickShift;
  };
  if (!(ok(brick.x) && ok(brick.y) && ok(brick.z))) {
    throw std::invalid_argument("a brick beyond the map's reach");
  }
}

void check_resident(const VoxelMap& map, const std::vector<DecodedBlock>& blocks,
                    const std::vector<BlockKey>& tiles) {
  for (const DecodedBlock& block : blocks) {
    if (map.residency().holds(block.key)) continue;
    const BlockKey tile = map.residency().tile_holding(block.key);
    if (std::find(tiles.begin(), tiles.end(), tile) == tiles.end()) {
      throw std::logic_error("a brick in a tile that is not in memory");
    }
  }
}

void forget(VoxelMap& map, const BlockKey& brick) {
  CellPool::Cache pool(map.pool());
  for (int place = 0; place < kBrickBlocks; ++place) {
    const BlockKey key = block_at(brick, place);
    if (Block* const block = map.find(key); block != nullptr) block->clear(map.rule(), pool);
  }
}

}  // namespace

ChangedBricks bricks_since(const VoxelMap& map, std::uint64_t revision) {
  ChangedBricks changed;
  const ReadLock lock(map);
  changed.revision = map.revision();
  std::vector<BlockKey> keys;
  map.for_each_block([&](const Block& block) {
    if (block.revision > revision) keys.push_back(brick_holding(block.key));
  });
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  changed.bricks.reserve(keys.size());
  for (const BlockKey& key : keys) changed.bricks.push_back(encoded(map, key));
  return changed;
}

void put_bricks(VoxelMap& map, const std::vector<BrickView>& bricks,
                const std::vector<BlockKey>& tiles) {
  std::vector<std::vector<DecodedBlock>> contents;
  for (const BrickView& brick : bricks) {
    check_key(brick.key);
    contents.push_back(decoded(brick, map.rule()));
  }
  const WriteLock lock(map);
  for (const std::vector<DecodedBlock>& blocks : contents) check_resident(map, blocks, tiles);
  for (const BlockKey& tile : tiles) map.residency().add(tile);
  for (std::size_t i = 0; i < bricks.size(); ++i) {
    forget(map, bricks[i].key);
    for (const DecodedBlock& block : contents[i]) {
      map.raise_revision(block.revision);
      map.write_block(block.key, block.states).revision = block.revision;
    }
  }
}

void drop_tiles(VoxelMap& map, const std::vector<BlockKey>& tiles) {
  const WriteLock lock(map);
  map.drop_tiles(tiles);
}

}  // namespace mapperd::map
