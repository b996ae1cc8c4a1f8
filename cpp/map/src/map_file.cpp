#include "mapperd/map/map_file.hpp"

#include <cstdint>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "mapperd/map/block_codec.hpp"
#include "mapperd/map/bytes.hpp"

namespace mapperd::map {
namespace {

constexpr std::uint32_t kVersion = 1;
constexpr std::uint32_t kVersionWithPrior = 2;
constexpr std::size_t kChecksumBytes = sizeof(std::uint32_t);
constexpr std::size_t kMinBlockBytes = 12 + 2 + 2 + 2;  // key, form and shift, one state

[[noreturn]] void refuse(const std::string& what) {
  throw std::invalid_argument("map file: " + what);
}

// Everything but a file of these versions that is whole.
std::string_view checked_content(std::string_view file) {
  if (file.substr(0, kMapFileMagic.size()) != kMapFileMagic) refuse("no map of mapperd");
  ByteReader head(file.substr(kMapFileMagic.size()));
  const auto version = head.left() < sizeof kVersion ? kVersion : head.get<std::uint32_t>();
  if (version != kVersion && version != kVersionWithPrior) {
    refuse("version " + std::to_string(version) + "; this program reads versions " +
           std::to_string(kVersion) + " and " + std::to_string(kVersionWithPrior));
  }
  if (file.size() < kMapFileMagic.size() + sizeof kVersion + kChecksumBytes)
    refuse("it ends too early");
  const std::string_view content = file.substr(0, file.size() - kChecksumBytes);
  if (ByteReader(file.substr(content.size())).get<std::uint32_t>() != crc32(content)) {
    refuse("the checksum is wrong: it was cut off or changed");
  }
  return content;
}

void check_same_prior(std::int32_t prior, const VoxelMap& map) {
  if (prior == file_units_of(map.rule().params().prior)) return;
  std::ostringstream what;
  what << "log-odds of an unobserved voxel are " << log_odds_of(prior) << " in it, "
       << map.rule().params().prior << " in the map: they are of different rules or priors";
  refuse(what.str());
}

void check_same_kind(std::uint32_t version, ByteReader& bytes, const VoxelMap& map) {
  const double resolution_m = bytes.get_double();
  if (!(resolution_m == map.resolution_m())) {
    std::ostringstream what;
    what.precision(17);
    what << "its voxels are " << resolution_m << " m, the map's " << map.resolution_m() << " m";
    refuse(what.str());
  }
  const auto low = bytes.get<std::int32_t>();
  const auto high = bytes.get<std::int32_t>();
  check_same_prior(version == kVersionWithPrior ? bytes.get<std::int32_t>() : 0, map);
  const IwloRule& rule = map.rule();
  if (rule.units_of_file(low) != rule.min_units() || rule.units_of_file(high) != rule.max_units()) {
    std::ostringstream what;
    what << "its clamps (L_min, L_max) are " << log_odds_of(low) << " and " << log_odds_of(high)
         << ", the map's " << rule.params().L_min << " and " << rule.params().L_max;
    refuse(what.str());
  }
  const auto settled = bytes.get<std::uint16_t>();
  if (settled != map.rule().settled_count()) {
    refuse("it counts to " + std::to_string(settled) + ", the map to " +
           std::to_string(map.rule().settled_count()) + " (decay_rate, min_alpha)");
  }
}

BlockKey next_key(ByteReader& bytes) {
  BlockKey key;
  key.x = bytes.get<std::int32_t>();
  key.y = bytes.get<std::int32_t>();
  key.z = bytes.get<std::int32_t>();
  return key;
}

void read_blocks(ByteReader& bytes, VoxelMap& map) {
  const auto count = bytes.get<std::uint64_t>();
  if (count > bytes.left() / kMinBlockBytes) bytes.refuse("more blocks than bytes for them");
  BlockKey last;
  BlockStates states;
  for (std::uint64_t i = 0; i < count; ++i) {
    const BlockKey key = next_key(bytes);
    if (i > 0 && !(last < key)) bytes.refuse("blocks out of order");
    if (!in_reach(key)) bytes.refuse("a block beyond the map's reach");
    decode_block(bytes, map.rule(), states);
    map.set_block(key, states);
    last = key;
  }
  if (bytes.left() != 0) bytes.refuse("bytes follow the last block");
}

}  // namespace

std::string encode_map(const VoxelMap& map) {
  std::string file(kMapFileMagic);
  const std::int32_t prior = file_units_of(map.rule().params().prior);
  put(file, prior == 0 ? kVersion : kVersionWithPrior);
  put(file, map.resolution_m());
  put(file, file_units_of(map.rule().params().L_min));
  put(file, file_units_of(map.rule().params().L_max));
  if (prior != 0) put(file, prior);
  put(file, map.rule().settled_count());
  const std::size_t count_at = file.size();
  std::uint64_t count = 0;
  put(file, count);
  {
    const ReadLock lock(map);
    for (const Block* block : map.sorted_blocks()) {
      if (block->known_count(map.pool()) == 0) continue;
      for (const std::int32_t coordinate : {block->key.x, block->key.y, block->key.z}) {
        put(file, coordinate);
      }
      encode_block(map, *block, file);
      ++count;
    }
  }
  std::string counted;
  put(counted, count);
  file.replace(count_at, counted.size(), counted);
  put(file, crc32(file));
  return file;
}

void load_map(std::string_view file, VoxelMap& map) {
  ByteReader bytes(checked_content(file));
  bytes.take(kMapFileMagic.size());
  const auto version = bytes.get<std::uint32_t>();
  check_same_kind(version, bytes, map);
  VoxelMap loaded(map.resolution_m(), map.rule().params());
  try {
    read_blocks(bytes, loaded);
  } catch (const std::invalid_argument& error) {
    refuse(error.what());
  }
  const WriteLock lock(map);
  map.take_blocks(loaded);
}

}  // namespace mapperd::map
