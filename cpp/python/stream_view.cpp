// The map as the map stream encodes it, as methods of VoxelMap, and the numbers of its blocks.
#include "mapperd/map/stream_view.hpp"

#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "bindings.hpp"
#include "mapperd/map/key_index.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

static_assert(sizeof(BlockKey) == 3 * sizeof(std::int32_t));

// Copied: Python may change an array while C++ reads it without the GIL.
std::vector<BlockKey> stream_keys_of(const py::object& object, const char* name) {
  const auto array = checked<std::int32_t>(object, name, 2);
  if (array.shape(1) != 3) throw std::invalid_argument(std::string(name) + " must be (N, 3)");
  const auto* keys = reinterpret_cast<const BlockKey*>(array.data());
  return {keys, keys + array.shape(0)};
}

template <typename T>
py::array_t<T> array_from(const std::vector<T>& values) {
  return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

py::array_t<bool> flags_from(const std::vector<std::uint8_t>& values) {
  py::array_t<bool> flags(static_cast<py::ssize_t>(values.size()));
  for (std::size_t i = 0; i < values.size(); ++i) flags.mutable_data()[i] = values[i] != 0;
  return flags;
}

py::array_t<std::int32_t> keys_from(const BlockKey* keys, std::size_t count) {
  return py::array_t<std::int32_t>({static_cast<py::ssize_t>(count), py::ssize_t{3}},
                                   reinterpret_cast<const std::int32_t*>(keys));
}

template <typename T>
py::array_t<T> planes_from(const std::vector<T>& values, std::size_t count) {
  return py::array_t<T>({static_cast<py::ssize_t>(count), py::ssize_t{kStreamCells}},
                        values.data());
}

StreamView view_of(int level, const std::string& detail, double log_odds_step,
                   double occupied_log_odds, double free_log_odds) {
  StreamView view{level, StreamDetail::kLogOdds, log_odds_step, {occupied_log_odds, free_log_odds}};
  if (detail == "classes") {
    view.detail = StreamDetail::kClasses;
  } else if (detail == "counts") {
    view.detail = StreamDetail::kCounts;
  } else if (detail != "log_odds") {
    throw std::invalid_argument("detail must be 'classes', 'log_odds' or 'counts'");
  }
  return view;
}

py::tuple changed(const VoxelMap& map, std::uint64_t revision, const py::object& bricks_object) {
  const std::vector<BlockKey> bricks = stream_keys_of(bricks_object, "bricks");
  ChangedBlocks found;
  {
    const py::gil_scoped_release release;
    found = changed_blocks(map, revision, bricks);
  }
  return py::make_tuple(found.revision, found.replaced_at,
                        keys_from(found.keys.data(), found.keys.size()),
                        array_from(found.revisions), flags_from(found.resident));
}

py::tuple digests(const VoxelMap& map, const StreamView& view, const py::object& keys_object) {
  const std::vector<BlockKey> keys = stream_keys_of(keys_object, "keys");
  StreamDigests encoded;
  {
    const py::gil_scoped_release release;
    encoded = stream_digests(map, view, keys);
  }
  return py::make_tuple(array_from(encoded.digests), array_from(encoded.revisions),
                        flags_from(encoded.resident));
}

py::tuple cells(const VoxelMap& map, const StreamView& view, const py::object& keys_object) {
  const std::vector<BlockKey> keys = stream_keys_of(keys_object, "keys");
  StreamBlocks encoded;
  {
    const py::gil_scoped_release release;
    encoded = stream_blocks(map, view, keys);
  }
  return py::make_tuple(encoded.revision, planes_from(encoded.cells, keys.size()),
                        planes_from(encoded.count_bits, keys.size()), flags_from(encoded.resident));
}

py::array_t<std::int64_t> numbers(KeyIndex& index, const py::object& keys_object, bool add) {
  const std::vector<BlockKey> keys = stream_keys_of(keys_object, "keys");
  py::array_t<std::int64_t> found(static_cast<py::ssize_t>(keys.size()));
  std::int64_t* number = found.mutable_data();
  for (const BlockKey& key : keys) {
    const std::uint32_t at = add ? index.find_or_add(key) : index.find(key);
    *number++ = at == KeyIndex::kNone ? -1 : std::int64_t{at};
  }
  return found;
}

py::array_t<std::int32_t> keys_at(const KeyIndex& index, const py::object& numbers_object) {
  const auto wanted = checked<std::int64_t>(numbers_object, "numbers", 1);
  py::array_t<std::int32_t> keys({wanted.shape(0), py::ssize_t{3}});
  auto* key = reinterpret_cast<BlockKey*>(keys.mutable_data());
  for (py::ssize_t i = 0; i < wanted.shape(0); ++i) {
    const auto number = static_cast<std::uint64_t>(wanted.at(i));
    if (number >= index.size()) throw py::index_error("a number that no key has");
    *key++ = index[number];
  }
  return keys;
}

}  // namespace

void bind_stream_view(py::module_& module) {
  py::class_<StreamView>(module, "StreamView")
      .def(py::init(&view_of), "level"_a, "detail"_a, py::kw_only(), "log_odds_step"_a,
           "occupied_log_odds"_a, "free_log_odds"_a);
  py::class_<KeyIndex>(module, "KeyIndex")
      .def(py::init<>())
      .def("__len__", &KeyIndex::size)
      .def_property_readonly("memory_bytes", &KeyIndex::memory_bytes)
      .def("numbers", &numbers, "keys"_a, "add"_a)
      .def("keys", &keys_at, "numbers"_a);
  static_cast<py::class_<VoxelMap>>(module.attr("VoxelMap"))
      .def("changed_blocks", &changed, "revision"_a, "bricks"_a)
      .def("stream_digests", &digests, "view"_a, "keys"_a)
      .def("stream_blocks", &cells, "view"_a, "keys"_a);
}

}  // namespace mapperd::python
