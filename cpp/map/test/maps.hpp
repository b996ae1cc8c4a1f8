// Small maps filled at random, for tests that compare with a look at every voxel.
#pragma once

#include <cstdint>
#include <vector>

#include "mapperd/map/voxel_map.hpp"
#include "scenes.hpp"

namespace maps {

// Observed voxels at random in a cube of -edge .. edge - 1 about the origin.
inline mapperd::map::VoxelMap random_map(std::uint64_t seed, int voxels, int edge,
                                         const mapperd::map::IwloParams& params = {}) {
  mapperd::map::VoxelMap map(0.1, params);
  scenes::Random random(seed);
  for (int i = 0; i < voxels; ++i) {
    const mapperd::map::VoxelIndex voxel{random.integer(-edge, edge - 1),
                                         random.integer(-edge, edge - 1),
                                         random.integer(-edge, edge - 1)};
    map.set(voxel, {static_cast<float>(random.uniform(-5.0, 5.0)),
                    static_cast<std::uint16_t>(random.integer(1, 60))});
  }
  return map;
}

struct Entry {
  mapperd::map::VoxelIndex voxel;
  mapperd::map::VoxelState state;

  friend bool operator==(const Entry& a, const Entry& b) {
    return a.voxel == b.voxel && a.state.log_odds == b.state.log_odds &&
           a.state.count == b.state.count;
  }
};

inline std::vector<Entry> content(const mapperd::map::VoxelMap& map) {
  std::vector<Entry> entries;
  map.for_each_known(
      [&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
        entries.push_back({voxel, state});
      });
  return entries;
}

// One free observation of some cells of a block.
inline bool see_free(mapperd::map::VoxelMap& map, const mapperd::map::BlockKey& key,
                     mapperd::map::CellSet cells = mapperd::map::kAllCells) {
  mapperd::map::CellPool::Cache pool(map.pool());
  return map.get_or_create(key).add_free(map.rule(), pool, cells);
}

// Opens every cell of a block and closes it again, after change(offset, units, count) of each
// voxel.
template <typename Change>
void change_block(mapperd::map::VoxelMap& map, const mapperd::map::BlockKey& key,
                  const Change& change) {
  mapperd::map::CellPool::Cache pool(map.pool());
  mapperd::map::Block& block = map.get_or_create(key);
  for (int cell = 0; cell < mapperd::map::kBlockCells; ++cell) {
    const mapperd::map::CellVoxels voxels = block.open(map.rule(), pool, cell);
    for (int v = 0; v < mapperd::map::kCellVoxels; ++v) {
      std::uint16_t count = voxels.count(v);
      change(mapperd::map::offset_of_cell(cell) + mapperd::map::offset_in_cell(v),
             voxels.units()[v], count);
      voxels.set_count(v, count);
    }
    block.close(map.rule(), pool, cell);
  }
}

inline void open_and_close(mapperd::map::VoxelMap& map, const mapperd::map::BlockKey& key) {
  change_block(map, key, [](int, std::int16_t&, std::uint16_t&) {});
}

}  // namespace maps
