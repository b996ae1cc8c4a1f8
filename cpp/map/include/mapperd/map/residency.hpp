/// \file
/// \brief Residency of a map's tiles in memory, for maps larger than memory.
///
/// Such a map is cut into tiles: cubes of whole blocks that come and go as one. A map without tiles
/// is resident everywhere.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "mapperd/common/memory_use.hpp"
#include "mapperd/map/block.hpp"

namespace mapperd::map {

/// Makes tiles resident with the content that they had when dropped; throws on failure.
using FetchTiles = std::function<void(const std::vector<BlockKey>& tiles)>;

/// Which tiles of a map on disk are in memory; fetches the others.
class Residency {
 public:
  Residency() = default;
  /// \throws std::invalid_argument for tiles without blocks, or an empty `fetch`.
  Residency(int tile_blocks, FetchTiles fetch);

  bool is_partial() const { return tile_blocks_ != 0; }
  BlockKey tile_holding(const BlockKey& block) const;
  bool holds(const BlockKey& block) const;

  /// Fetches all tiles that hold these blocks. Resident ones are passed too, because they are in
  /// use. Threads: the caller must hold no lock of the map.
  void fetch(const std::vector<BlockKey>& blocks) const;

  void add(const BlockKey& tile);
  void remove(const BlockKey& tile);
  std::size_t memory_bytes() const { return allocated_by(tiles_); }

 private:
  int tile_blocks_ = 0;  ///< along an edge
  FetchTiles fetch_;
  std::vector<BlockKey> tiles_;  ///< resident, sorted
};

}  // namespace mapperd::map
