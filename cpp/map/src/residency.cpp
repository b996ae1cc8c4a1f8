#include "mapperd/map/residency.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace mapperd::map {

Residency::Residency(int tile_blocks, FetchTiles fetch)
    : tile_blocks_(tile_blocks), fetch_(std::move(fetch)) {
  if (tile_blocks < 1 || tile_blocks > kMaxBlock || fetch_ == nullptr) {
    throw std::invalid_argument("a tile needs blocks, and somebody to fetch it");
  }
}

BlockKey Residency::tile_holding(const BlockKey& block) const {
  const auto tile = [this](std::int32_t i) {
    return i >= 0 ? i / tile_blocks_ : -1 - (-1 - i) / tile_blocks_;
  };
  return {tile(block.x), tile(block.y), tile(block.z)};
}

bool Residency::holds(const BlockKey& block) const {
  return !is_partial() || std::binary_search(tiles_.begin(), tiles_.end(), tile_holding(block));
}

void Residency::fetch(const std::vector<BlockKey>& blocks) const {
  if (!is_partial()) return;
  std::vector<BlockKey> tiles;
  for (const BlockKey& block : blocks) {
    const BlockKey tile = tile_holding(block);
    // Neighbours follow each other: nearly all are caught here.
    if (tiles.empty() || !(tiles.back() == tile)) tiles.push_back(tile);
  }
  std::sort(tiles.begin(), tiles.end());
  tiles.erase(std::unique(tiles.begin(), tiles.end()), tiles.end());
  if (!tiles.empty()) fetch_(tiles);
}

void Residency::add(const BlockKey& tile) {
  const auto at = std::lower_bound(tiles_.begin(), tiles_.end(), tile);
  if (at == tiles_.end() || !(*at == tile)) tiles_.insert(at, tile);
}

void Residency::remove(const BlockKey& tile) {
  const auto at = std::lower_bound(tiles_.begin(), tiles_.end(), tile);
  if (at != tiles_.end() && *at == tile) tiles_.erase(at);
}

}  // namespace mapperd::map
