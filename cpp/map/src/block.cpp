#include "mapperd/map/block.hpp"

#include <algorithm>
#include <cstring>

#include "mapperd/map/kernels.hpp"

namespace mapperd::map {
namespace {

constexpr std::uint32_t kMaxPending = 255;

std::uint32_t packed(const Voxel& voxel) {
  return static_cast<std::uint16_t>(voxel.units) | std::uint32_t{voxel.count} << 16;
}

Voxel unpacked(std::uint32_t state) {
  return {static_cast<std::int16_t>(state & 0xFFFF), static_cast<std::uint16_t>(state >> 16)};
}

std::uint32_t pending_limit(const IwloRule& rule) {
  return std::min(kMaxPending, rule.free_steps_to_floor());
}

template <typename Visit>
void for_each_cell(CellSet cells, const Visit& visit) {
  for (; cells != 0; cells &= cells - 1) visit(__builtin_ctzll(cells));
}

bool each_equals_the_next(const void* bytes, std::size_t size, std::size_t step) {
  const auto* at = static_cast<const std::byte*>(bytes);
  return std::memcmp(at, at + step, size - step) == 0;
}

}  // namespace

bool Block::add_free(const IwloRule& rule, CellPool::Cache& pool, CellSet cells) {
  cells &= ~at_floor_;
  if (cells == 0) return false;
  // Cells of one state above the limit take the step at once, as one voxel.
  const CellSet scaled = cells & above_;
  for_each_cell(scaled, [&](int cell) {
    if (!is_held(cell)) {
      Voxel voxel = alike(rule, cell);
      rule.add_free(voxel.units, voxel.count);
      set_alike(rule, cell, voxel);
      return;
    }
    std::uint8_t codes[kCellVoxels];
    std::memset(codes, kCodeFree, sizeof codes);
    const CellVoxels voxels = open(rule, pool, cell);
    kernels().apply(rule.tables(), codes, nullptr, voxels.units(), voxels.counts(),
                    rule.count_bytes());
    close(rule, pool, cell);
  });
  cells &= ~scaled;  // not of `above_`: a cell that came down has had its step
  if (cells == kAllCells) {
    for (std::uint8_t& pending : pending_) ++pending;
  } else {
    for_each_cell(cells, [&](int cell) { ++pending_[static_cast<std::size_t>(cell)]; });
  }
  if (++max_pending_ >= pending_limit(rule)) settle(rule, pool);
  return true;
}

// Applies what is pending where it is so much that it must be.
void Block::settle(const IwloRule& rule, CellPool::Cache& pool) {
  const std::uint32_t limit = pending_limit(rule);
  max_pending_ = 0;
  for (int cell = 0; cell < kBlockCells; ++cell) {
    auto& pending = pending_[static_cast<std::size_t>(cell)];
    if (pending >= limit) {
      if (pending >= rule.free_steps_to_floor()) {  // all voxels are alike by now
        fill(rule, pool, cell, {rule.min_units(), rule.settled_count()});
      } else if (is_held(cell)) {
        open(rule, pool, cell);
        close(rule, pool, cell);
      } else {
        set_alike(rule, cell, alike(rule, cell));
      }
    }
    max_pending_ = std::max(max_pending_, pending);
  }
}

CellVoxels Block::open(const IwloRule& rule, CellPool::Cache& pool, int cell) {
  const auto i = static_cast<std::size_t>(cell);
  if (is_held(cell)) {
    apply_pending(rule, pool, cell);
    return pool[state_[i]];
  }
  const Voxel voxel = alike(rule, cell);
  const std::uint32_t slot = pool.take();
  const CellVoxels voxels = pool[slot];
  std::fill_n(voxels.units(), kCellVoxels, voxel.units);
  if (rule.count_bytes() == 1) {
    std::memset(voxels.counts(), voxel.count, kCellVoxels);
  } else {
    std::fill_n(reinterpret_cast<std::uint16_t*>(voxels.counts()), kCellVoxels, voxel.count);
  }
  state_[i] = slot;
  pending_[i] = 0;
  held_ |= cell_bit(cell);
  at_floor_ &= ~cell_bit(cell);
  return voxels;
}

// Nothing is pending unless every voxel's free steps are unscaled.
void Block::apply_pending(const IwloRule& rule, CellPool::Cache& pool, int cell) {
  const auto i = static_cast<std::size_t>(cell);
  const std::uint32_t times = pending_[i];
  if (times == 0) return;
  const CellVoxels voxels = pool[state_[i]];
  std::int16_t* const units = voxels.units();
  for (int v = 0; v < kCellVoxels; ++v) {
    std::uint16_t count = voxels.count(v);
    rule.add_unscaled_free(units[v], count, times);
    voxels.set_count(v, count);
  }
  pending_[i] = 0;
}

void Block::close(const IwloRule& rule, CellPool::Cache& pool, int cell) {
  const auto i = static_cast<std::size_t>(cell);
  const CellVoxels voxels = pool[state_[i]];
  const std::int16_t* const units = voxels.units();
  if (units[0] == units[kCellVoxels - 1] &&
      each_equals_the_next(units, sizeof(std::int16_t) * kCellVoxels, sizeof(std::int16_t)) &&
      each_equals_the_next(voxels.counts(),
                           kCellVoxels * static_cast<std::size_t>(rule.count_bytes()),
                           static_cast<std::size_t>(rule.count_bytes()))) {
    return fill(rule, pool, cell, {units[0], voxels.count(0)});
  }
  std::int16_t highest = units[0];
  for (int v = 1; v < kCellVoxels; ++v) highest = std::max(highest, units[v]);
  above_ &= ~cell_bit(cell);
  if (highest > rule.unscaled_up_to()) above_ |= cell_bit(cell);
}

void Block::fill(const IwloRule& rule, CellPool::Cache& pool, int cell, const Voxel& voxel) {
  if (is_held(cell)) pool.give_back(state_[static_cast<std::size_t>(cell)]);
  set_alike(rule, cell, voxel);
}

void Block::set_alike(const IwloRule& rule, int cell, const Voxel& voxel) {
  const CellSet bit = cell_bit(cell);
  const auto i = static_cast<std::size_t>(cell);
  state_[i] = packed(voxel);
  pending_[i] = 0;
  held_ &= ~bit;
  above_ &= ~bit;
  at_floor_ &= ~bit;
  if (voxel.units > rule.unscaled_up_to()) above_ |= bit;
  if (voxel == Voxel{rule.min_units(), rule.settled_count()}) at_floor_ |= bit;
}

void Block::clear(const IwloRule& rule, CellPool::Cache& pool) {
  for (int cell = 0; cell < kBlockCells; ++cell) fill(rule, pool, cell, {});
}

void Block::move_cells(const CellPool& from, CellPool::Cache& to) {
  for_each_cell(held_, [&](int cell) {
    std::uint32_t& state = state_[static_cast<std::size_t>(cell)];
    const std::uint32_t slot = to.take();
    std::memcpy(to[slot].units(), from[state].units(), CellVoxels::bytes(from.count_bytes()));
    state = slot;
  });
}

Voxel Block::alike(const IwloRule& rule, int cell) const {
  const auto i = static_cast<std::size_t>(cell);
  Voxel voxel = unpacked(state_[i]);
  if (pending_[i] > 0) rule.add_unscaled_free(voxel.units, voxel.count, pending_[i]);
  return voxel;
}

bool Block::all_alike(const IwloRule& rule, Voxel& voxel) const {
  if (held_ != 0) return false;
  voxel = alike(rule, 0);
  for (int cell = 1; cell < kBlockCells; ++cell) {
    if (!(alike(rule, cell) == voxel)) return false;
  }
  return true;
}

int Block::known_count(const CellPool& pool) const {
  int known = 0;
  for (int cell = 0; cell < kBlockCells; ++cell) {
    const auto i = static_cast<std::size_t>(cell);
    if (pending_[i] > 0 || !is_held(cell)) {
      known += pending_[i] > 0 || unpacked(state_[i]).count != 0 ? kCellVoxels : 0;
      continue;
    }
    const CellVoxels voxels = pool[state_[i]];
    for (int v = 0; v < kCellVoxels; ++v) known += voxels.count(v) != 0 ? 1 : 0;
  }
  return known;
}

Voxel Block::voxel(const IwloRule& rule, const CellPool& pool, int offset) const {
  const CellPlace at = cell_place(offset);
  if (!is_held(at.cell)) return alike(rule, at.cell);
  const auto i = static_cast<std::size_t>(at.cell);
  const CellVoxels voxels = pool[state_[i]];
  Voxel voxel{voxels.units()[at.voxel], voxels.count(at.voxel)};
  if (pending_[i] > 0) rule.add_unscaled_free(voxel.units, voxel.count, pending_[i]);
  return voxel;
}

void Block::copy_voxels(const IwloRule& rule, const CellPool& pool, DenseVoxels& out) const {
  for (int cell = 0; cell < kBlockCells; ++cell) {
    const auto begin = static_cast<std::size_t>(offset_of_cell(cell));
    if (!is_held(cell)) {
      const Voxel voxel = alike(rule, cell);
      for (int row = 0; row < kCellEdge * kCellEdge; ++row) {
        const auto at = begin + static_cast<std::size_t>(offset_in_cell(kCellEdge * row));
        std::fill_n(&out.units[at], kCellEdge, voxel.units);
        std::fill_n(&out.count[at], kCellEdge, voxel.count);
      }
      continue;
    }
    DenseCell voxels;
    copy_held(rule, pool, cell, voxels);
    for (std::size_t v = 0; v < kCellVoxels; ++v) {
      const auto at = begin + static_cast<std::size_t>(offset_in_cell(static_cast<int>(v)));
      out.units[at] = voxels.units[v];
      out.count[at] = voxels.count[v];
    }
  }
}

void Block::copy_held(const IwloRule& rule, const CellPool& pool, int cell, DenseCell& out) const {
  const auto i = static_cast<std::size_t>(cell);
  const CellVoxels voxels = pool[state_[i]];
  for (std::size_t v = 0; v < kCellVoxels; ++v) {
    out.units[v] = voxels.units()[v];
    out.count[v] = voxels.count(static_cast<int>(v));
    if (pending_[i] > 0) rule.add_unscaled_free(out.units[v], out.count[v], pending_[i]);
  }
}

}  // namespace mapperd::map
