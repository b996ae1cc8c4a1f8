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
  map.for_each_known([&](const mapperd::map::VoxelIndex& voxel, const mapperd::map::VoxelState& state) {
    entries.push_back({voxel, state});
  });
  return entries;
}

}  // namespace maps
