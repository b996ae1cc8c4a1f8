#include "mapperd/block_codec.hpp"

#include <algorithm>
#include <array>
#include <memory>

namespace mapperd {
namespace {

enum class Form : std::uint8_t { alike = 1, one_by_one = 2 };

constexpr std::size_t kMaskBytes = kBlockVoxels / 8;

using Voxels = std::array<Voxel, kBlockVoxels>;

void encode_alike(const Voxel& voxel, std::string& out) {
  put(out, static_cast<std::uint8_t>(Form::alike));
  put(out, voxel.units);
  put(out, voxel.count);
}

void encode_one_by_one(const Voxels& voxels, std::string& out) {
  put(out, static_cast<std::uint8_t>(Form::one_by_one));
  const std::size_t mask = out.size();
  out.append(kMaskBytes, '\0');
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    if (voxels[i].count == 0) continue;
    char& byte = out[mask + i / 8];
    byte = static_cast<char>(static_cast<unsigned char>(byte) | 1U << i % 8);
    put(out, voxels[i].units);
  }
  for (const Voxel& voxel : voxels) {
    if (voxel.count != 0) put(out, voxel.count);
  }
}

std::int32_t checked_units(const ByteReader& bytes, const IwloRule& rule, std::int32_t units) {
  if (rule.clamped(units) != units) bytes.refuse("log-odds beyond the map's clamps");
  return units;
}

std::uint16_t checked_count(const ByteReader& bytes, const IwloRule& rule, std::uint16_t count) {
  if (count == 0) bytes.refuse("an observed voxel with count 0");
  if (count > rule.settled_count()) bytes.refuse("a count beyond the map's settled one");
  return count;
}

Voxel decode_alike(ByteReader& bytes, const IwloRule& rule) {
  const std::int32_t units = checked_units(bytes, rule, bytes.get<std::int32_t>());
  return {units, checked_count(bytes, rule, bytes.get<std::uint16_t>())};
}

void decode_one_by_one(ByteReader& bytes, const IwloRule& rule, Voxels& voxels) {
  const std::string_view mask = bytes.take(kMaskBytes);
  const auto is_known = [mask](std::size_t i) {
    return (static_cast<unsigned char>(mask[i / 8]) >> i % 8 & 1U) != 0;
  };
  bool any = false;
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    if (!is_known(i)) continue;
    voxels[i].units = checked_units(bytes, rule, bytes.get<std::int32_t>());
    any = true;
  }
  if (!any) bytes.refuse("a block without observed voxels");
  for (std::size_t i = 0; i < voxels.size(); ++i) {
    if (is_known(i)) voxels[i].count = checked_count(bytes, rule, bytes.get<std::uint16_t>());
  }
}

}  // namespace

void encode_block(const Block& block, const IwloRule& rule, std::string& out) {
  if (!block.is_dense()) return encode_alike(block.voxel(rule, 0), out);
  Voxels voxels;
  for (std::size_t i = 0; i < voxels.size(); ++i)
    voxels[i] = block.voxel(rule, static_cast<int>(i));
  const bool alike = std::all_of(voxels.begin(), voxels.end(), [&](const Voxel& voxel) {
    return voxel.units == voxels[0].units && voxel.count == voxels[0].count;
  });
  if (alike) return encode_alike(voxels[0], out);
  encode_one_by_one(voxels, out);
}

void decode_block(ByteReader& bytes, const IwloRule& rule, Block& block) {
  switch (static_cast<Form>(bytes.get<std::uint8_t>())) {
    case Form::alike:
      return block.fill(decode_alike(bytes, rule));
    case Form::one_by_one: {
      Voxels voxels{};
      decode_one_by_one(bytes, rule, voxels);
      DenseVoxels& dense = block.open(rule);
      for (std::size_t i = 0; i < voxels.size(); ++i) {
        dense.units[i] = voxels[i].units;
        dense.count[i] = voxels[i].count;
      }
      return block.close(rule);
    }
  }
  bytes.refuse("a block in a form that this version does not know");
}

}  // namespace mapperd
