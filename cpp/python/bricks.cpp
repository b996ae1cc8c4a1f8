// A map in tiles, and its bricks as bytes, as methods of VoxelMap.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <string_view>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "mapperd/map/brick.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

using Key = std::array<std::int32_t, 3>;

BlockKey key_of(const Key& key) { return {key[0], key[1], key[2]}; }

py::tuple tuple_of(const BlockKey& key) { return py::make_tuple(key.x, key.y, key.z); }

std::vector<BlockKey> keys_of(const std::vector<Key>& keys) {
  std::vector<BlockKey> all;
  for (const Key& key : keys) all.push_back(key_of(key));
  return all;
}

void cut_into_tiles(VoxelMap& map, int tile_bricks, const py::function& fetch) {
  if (tile_bricks < 1 || tile_bricks > kMaxBlock / kBrickEdge) {
    throw std::invalid_argument("tile_bricks must be 1 or more");
  }
  // The integrators call this without the GIL and without a lock of the map.
  const auto ask = [fetch](const std::vector<BlockKey>& tiles) {
    const py::gil_scoped_acquire acquire;
    py::list keys;
    for (const BlockKey& tile : tiles) keys.append(tuple_of(tile));
    fetch(keys);
  };
  Residency residency(tile_bricks * kBrickEdge, ask);
  const py::gil_scoped_release release;
  const WriteLock lock(map);
  map.cut_into_tiles(std::move(residency));
}

void limit_to_tile(VoxelMap& map, const Key& tile, int tile_bricks) {
  const auto edge = static_cast<std::int64_t>(tile_bricks) * kBrickEdge;
  BlockBox box;
  const auto limit = [edge](std::int32_t i, std::int32_t& first, std::int32_t& last) {
    const std::int64_t low = i * edge;
    if (edge < 1 || low < -kMaxBlock || low + edge - 1 > kMaxBlock) {
      throw std::invalid_argument("the tile lies beyond the map's reach");
    }
    first = static_cast<std::int32_t>(low);
    last = static_cast<std::int32_t>(low + edge - 1);
  };
  limit(tile[0], box.first.x, box.last.x);
  limit(tile[1], box.first.y, box.last.y);
  limit(tile[2], box.first.z, box.last.z);
  const py::gil_scoped_release release;
  const WriteLock lock(map);
  map.limit_to(box);
}

py::tuple since(const VoxelMap& map, std::uint64_t revision) {
  ChangedBricks changed;
  {
    const py::gil_scoped_release release;
    changed = bricks_since(map, revision);
  }
  py::list bricks;
  for (const Brick& brick : changed.bricks) {
    bricks.append(py::make_tuple(tuple_of(brick.key), brick.revision, py::bytes(brick.bytes)));
  }
  return py::make_tuple(changed.revision, bricks);
}

// The list holds references to the bytes, which cannot change.
void put(VoxelMap& map, const std::vector<std::pair<Key, py::bytes>>& bricks,
         const std::vector<Key>& tiles) {
  std::vector<BrickView> views;
  for (const auto& [key, bytes] : bricks) views.push_back({key_of(key), std::string_view(bytes)});
  const std::vector<BlockKey> resident = keys_of(tiles);
  const py::gil_scoped_release release;
  put_bricks(map, views, resident);
}

void drop(VoxelMap& map, const std::vector<Key>& tiles) {
  const std::vector<BlockKey> gone = keys_of(tiles);
  const py::gil_scoped_release release;
  drop_tiles(map, gone);
}

bool is_in_tiles(const VoxelMap& map) {
  const py::gil_scoped_release release;
  const ReadLock lock(map);
  return map.residency().is_partial();
}

void raise_revision(VoxelMap& map, std::uint64_t least) {
  const py::gil_scoped_release release;
  const WriteLock lock(map);
  map.raise_revision(least);
}

}  // namespace

void bind_bricks(py::module_& module) {
  module.attr("BRICK_VOXELS") = kBrickEdge * kBlockEdge;
  static_cast<py::class_<VoxelMap>>(module.attr("VoxelMap"))
      .def_property_readonly("is_in_tiles", &is_in_tiles)
      .def("cut_into_tiles", &cut_into_tiles, "tile_bricks"_a, "fetch"_a)
      .def("limit_to_tile", &limit_to_tile, "tile"_a, "tile_bricks"_a)
      .def("bricks_since", &since, "revision"_a)
      .def("put_bricks", &put, "bricks"_a, "tiles"_a = std::vector<Key>{})
      .def("drop_tiles", &drop, "tiles"_a)
      .def("raise_revision", &raise_revision, "min_revision"_a);
}

}  // namespace mapperd::python
