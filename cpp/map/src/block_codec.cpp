#include "mapperd/map/block_codec.hpp"

#include <algorithm>
#include <array>
#include <memory>

namespace mapperd::map {
namespace {

enum class Form : std::uint8_t { alike = 1, one_by_one = 2 };

constexpr std::size_t kMaskBytes = kBlockVoxels / 8;

void encode_alike(const Voxel& voxel, std::string& out) {
  put(out, static_cast<std::uint8_t>(Form::alike));
  put(out, voxel.units);
  put(out, voxel.count);
}

// Appends the known ones of some numbers; written straight on where all are known.
template <typename T>
void encode_known(const std::array<T, kBlockVoxels>& numbers, const DenseVoxels& voxels,
                  std::size_t known, std::string& out) {
  const std::size_t begin = out.size();
  out.resize(begin + known * sizeof(T));
  char* at = &out[begin];
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (known != kBlockVoxels && voxels.count[i] == 0) continue;
    write_number(at, numbers[i]);
    at += sizeof(T);
  }
}

void encode_one_by_one(const DenseVoxels& voxels, std::string& out) {
  put(out, static_cast<std::uint8_t>(Form::one_by_one));
  std::size_t known = 0;
  for (std::size_t i = 0; i < kBlockVoxels; i += 8) {
    unsigned byte = 0;
    for (unsigned bit = 0; bit < 8; ++bit) {
      const unsigned is_known = voxels.count[i + bit] != 0 ? 1U : 0U;
      byte |= is_known << bit;
      known += is_known;
    }
    put(out, static_cast<std::uint8_t>(byte));
  }
  encode_known(voxels.units, voxels, known, out);
  encode_known(voxels.count, voxels, known, out);
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

void decode_one_by_one(ByteReader& bytes, const IwloRule& rule, DenseVoxels& voxels) {
  const std::string_view mask = bytes.take(kMaskBytes);
  bool any = false;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    const bool known = (static_cast<unsigned char>(mask[i / 8]) >> i % 8 & 1U) != 0;
    voxels.units[i] = known ? checked_units(bytes, rule, bytes.get<std::int32_t>()) : 0;
    voxels.count[i] = known ? 1 : 0;
    any = any || known;
  }
  if (!any) bytes.refuse("a block without observed voxels");
  for (std::uint16_t& count : voxels.count) {
    if (count != 0) count = checked_count(bytes, rule, bytes.get<std::uint16_t>());
  }
}

}  // namespace

void encode_block(const Block& block, const IwloRule& rule, std::string& out) {
  if (!block.is_dense()) return encode_alike(block.voxel(rule, 0), out);
  DenseVoxels voxels;
  block.copy_voxels(rule, voxels);
  const auto differs = [](const auto& numbers) {
    return std::any_of(numbers.begin(), numbers.end(), [&](auto n) { return n != numbers[0]; });
  };
  if (!differs(voxels.units) && !differs(voxels.count)) {
    return encode_alike({voxels.units[0], voxels.count[0]}, out);
  }
  encode_one_by_one(voxels, out);
}

void decode_block(ByteReader& bytes, const IwloRule& rule, Block& block) {
  switch (static_cast<Form>(bytes.get<std::uint8_t>())) {
    case Form::alike:
      return block.fill(decode_alike(bytes, rule));
    case Form::one_by_one: {
      DenseVoxels voxels;
      decode_one_by_one(bytes, rule, voxels);
      block.open(rule) = voxels;
      return block.close(rule);
    }
  }
  bytes.refuse("a block in a form that this version does not know");
}

}  // namespace mapperd::map
