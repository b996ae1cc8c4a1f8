// Which part of a map is in memory, where the whole of it is larger.
//
// Such a map is cut into tiles: cubes of whole blocks that come and go as one. A map that nobody
// cut is resident everywhere.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "mapperd/common/memory_use.hpp"
#include "mapperd/map/block.hpp"

namespace mapperd::map {

// Makes tiles resident, whole, as they were when they went; throws when it cannot.
using FetchTiles = std::function<void(const std::vector<BlockKey>& tiles)>;

class Residency {
 public:
  Residency() = default;
  // Throws std::invalid_argument for tiles without blocks, or without somebody to fetch them.
  Residency(int tile_blocks, FetchTiles fetch);

  bool is_partial() const { return tile_blocks_ != 0; }
  BlockKey tile_holding(const BlockKey& block) const;
  bool holds(const BlockKey& block) const;

  // Has all tiles fetched that these blocks lie in, the resident ones too: they are in use. Who
  // calls it holds no lock of the map.
  void fetch(const std::vector<BlockKey>& blocks) const;

  void add(const BlockKey& tile);
  void remove(const BlockKey& tile);
  std::size_t memory_bytes() const { return allocated_by(tiles_); }

 private:
  int tile_blocks_ = 0;  // along an edge
  FetchTiles fetch_;
  std::vector<BlockKey> tiles_;  // resident, sorted
};

}  // namespace mapperd::map
