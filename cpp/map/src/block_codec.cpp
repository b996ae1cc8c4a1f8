#include "mapperd/map/block_codec.hpp"

#include <algorithm>

namespace mapperd::map {
namespace {

enum class Form : std::uint8_t {
  kOldAlike = 1,
  kOldOneByOne = 2,
  kAlike = 3,
  kCells = 4,
  kCellsWide = 5,
};

constexpr std::size_t kMaskBytes = kBlockVoxels / 8;
constexpr int kMaxShift = 24;

Voxel checked(const ByteReader& bytes, const IwloRule& rule, std::int64_t units, unsigned count) {
  if (units < rule.min_units() || units > rule.max_units()) {
    bytes.refuse("log-odds beyond the map's clamps");
  }
  if (count == 0) bytes.refuse("an observed voxel with count 0");
  if (count > rule.settled_count()) bytes.refuse("a count beyond the map's settled one");
  return {static_cast<std::int16_t>(units), static_cast<std::uint16_t>(count)};
}

// Units of 2^-shift, as those of the rule.
class Units {
 public:
  Units(ByteReader& bytes, const IwloRule& rule) {
    const int shift = bytes.get<std::uint8_t>();
    if (shift > kMaxShift) bytes.refuse("log-odds in a unit that no map has");
    scale_ = std::ldexp(1.0, rule.shift() - shift);
  }
  std::int64_t next(ByteReader& bytes) const {
    return std::llrint(scale_ * bytes.get<std::int16_t>());
  }

 private:
  double scale_ = 1.0;
};

void decode_old(ByteReader& bytes, const IwloRule& rule, BlockStates& states) {
  const std::string_view mask = bytes.take(kMaskBytes);
  std::vector<std::size_t> known;
  for (std::size_t i = 0; i < kBlockVoxels; ++i) {
    if ((static_cast<unsigned char>(mask[i / 8]) >> i % 8 & 1U) != 0) known.push_back(i);
  }
  if (known.empty()) bytes.refuse("a block without observed voxels");
  std::vector<std::int64_t> units;
  units.reserve(known.size());
  for (std::size_t k = 0; k < known.size(); ++k) {
    units.push_back(rule.units_of_file(bytes.get<std::int32_t>()));
  }
  for (std::size_t k = 0; k < known.size(); ++k) {
    states[known[k]] = checked(bytes, rule, units[k], bytes.get<std::uint16_t>());
  }
}

void decode_mixed(ByteReader& bytes, const IwloRule& rule, const Units& shifted, bool wide,
                  Voxel* states) {
  std::array<std::int64_t, kCellVoxels> units;
  for (std::int64_t& each : units) each = shifted.next(bytes);
  bool any = false;
  for (int v = 0; v < kCellVoxels; ++v) {
    const unsigned count = wide ? bytes.get<std::uint16_t>() : bytes.get<std::uint8_t>();
    const std::int64_t each = units[static_cast<std::size_t>(v)];
    if (count == 0 && each != 0) bytes.refuse("log-odds of a voxel that was not observed");
    if (count == 0) continue;
    states[offset_in_cell(v)] = checked(bytes, rule, each, count);
    any = true;
  }
  if (!any) bytes.refuse("a cell without observed voxels");
}

void decode_cells(ByteReader& bytes, const IwloRule& rule, bool wide, BlockStates& states) {
  const Units shifted(bytes, rule);
  const auto alike = bytes.get<std::uint64_t>();
  const auto mixed = bytes.get<std::uint64_t>();
  if ((alike & mixed) != 0) bytes.refuse("a cell in two forms");
  if ((alike | mixed) == 0) bytes.refuse("a block without observed voxels");
  for (int cell = 0; cell < kBlockCells; ++cell) {
    Voxel* const first = &states[static_cast<std::size_t>(offset_of_cell(cell))];
    if ((mixed & cell_bit(cell)) != 0) decode_mixed(bytes, rule, shifted, wide, first);
    if ((alike & cell_bit(cell)) == 0) continue;
    const std::int64_t units = shifted.next(bytes);
    const Voxel voxel = checked(bytes, rule, units, bytes.get<std::uint16_t>());
    for (int v = 0; v < kCellVoxels; ++v) first[offset_in_cell(v)] = voxel;
  }
}

// Units and counts of a cell, voxel by voxel. The bytes are made room for at once: there are many.
template <typename Count>
void put_mixed(const DenseCell& voxels, std::string& out) {
  const std::size_t begin = out.size();
  out.resize(begin + kCellVoxels * (sizeof(std::int16_t) + sizeof(Count)));
  char* units = &out[begin];
  char* counts = units + kCellVoxels * sizeof(std::int16_t);
  for (std::size_t v = 0; v < kCellVoxels; ++v) {
    write_number(units, voxels.units[v]);
    write_number(counts, static_cast<Count>(voxels.count[v]));
    units += sizeof(std::int16_t);
    counts += sizeof(Count);
  }
}

template <typename Array>
bool is_one_value(const Array& values) {
  return std::all_of(values.begin(), values.end(),
                     [&](const auto& value) { return value == values.front(); });
}

// A block's cells by their voxels, however they are held.
class Cells {
 public:
  Cells(const VoxelMap& map, const Block& block) {
    for (int cell = 0; cell < kBlockCells; ++cell) {
      const auto i = static_cast<std::size_t>(cell);
      if (!block.is_held(cell)) {
        one_[i] = block.alike(map.rule(), cell);
        if (one_[i].count != 0) alike |= cell_bit(cell);
        continue;
      }
      DenseCell& voxels = each_[i];
      block.copy_held(map.rule(), map.pool(), cell, voxels);
      one_[i] = {voxels.units[0], voxels.count[0]};
      const bool equally_often = is_one_value(voxels.count);
      if (equally_often && voxels.count[0] == 0) continue;
      (equally_often && is_one_value(voxels.units) ? alike : mixed) |= cell_bit(cell);
    }
  }

  CellSet alike = 0;  // and observed
  CellSet mixed = 0;

  bool is_one() const { return mixed == 0 && is_one_value(one_); }
  const Voxel& one(int cell) const { return one_[static_cast<std::size_t>(cell)]; }
  const DenseCell& each(int cell) const { return each_[static_cast<std::size_t>(cell)]; }

 private:
  std::array<Voxel, kBlockCells> one_;
  std::array<DenseCell, kBlockCells> each_;  // of those that are held
};

}  // namespace

void encode_block(const VoxelMap& map, const Block& block, std::string& out) {
  const IwloRule& rule = map.rule();
  const auto put_form = [&](Form form) {
    put(out, static_cast<std::uint8_t>(form));
    put(out, static_cast<std::uint8_t>(rule.shift()));
  };
  const auto put_one = [&](const Voxel& voxel) {
    put(out, voxel.units);
    put(out, voxel.count);
  };
  const Cells cells(map, block);
  if (cells.is_one()) {
    put_form(Form::kAlike);
    put_one(cells.one(0));
    return;
  }
  const bool wide = rule.count_bytes() == 2;
  put_form(wide ? Form::kCellsWide : Form::kCells);
  put(out, cells.alike);
  put(out, cells.mixed);
  for (int cell = 0; cell < kBlockCells; ++cell) {
    if ((cells.alike & cell_bit(cell)) != 0) put_one(cells.one(cell));
    if ((cells.mixed & cell_bit(cell)) == 0) continue;
    if (wide) {
      put_mixed<std::uint16_t>(cells.each(cell), out);
    } else {
      put_mixed<std::uint8_t>(cells.each(cell), out);
    }
  }
}

void decode_block(ByteReader& bytes, const IwloRule& rule, BlockStates& states) {
  states.fill({});
  switch (static_cast<Form>(bytes.get<std::uint8_t>())) {
    case Form::kOldAlike: {
      const std::int64_t units = rule.units_of_file(bytes.get<std::int32_t>());
      states.fill(checked(bytes, rule, units, bytes.get<std::uint16_t>()));
      return;
    }
    case Form::kOldOneByOne:
      return decode_old(bytes, rule, states);
    case Form::kAlike: {
      const std::int64_t units = Units(bytes, rule).next(bytes);
      states.fill(checked(bytes, rule, units, bytes.get<std::uint16_t>()));
      return;
    }
    case Form::kCells:
      return decode_cells(bytes, rule, false, states);
    case Form::kCellsWide:
      return decode_cells(bytes, rule, true, states);
  }
  bytes.refuse("a block in a form that this version does not know");
}

}  // namespace mapperd::map
