#include "mapperd/map/block_evidence.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/map/cube_cut.hpp"

namespace mapperd::map {
namespace {

constexpr int kCell = kCellEdge;
constexpr double kTie = 1e-9;  // parts, and edges of a voxel: what rounding can make of a tie

// The error of a sampled mean weight is up to kSpread sigma / (lines sqrt(part)) in 99 of 100
// voxels, sigma being how much the weights inside the voxel differ and part how much of it is
// occupied; measured for 8 to 128 lines, see docs/mapping.md.
constexpr double kSpread = 3.0;
constexpr int kFewestLines = 8;
constexpr int kMostLines = 128;
// A part of the volume as near as this to the limit that it is compared with is sampled again.
constexpr double kUnclear = 0.12;
constexpr int kLinesIfUnclear = 64;
// Edges of a voxel by which the place where a moving sonar sees it may be off where weights are
// sampled: little beside what that is off by.
constexpr double kStraight = 0.005;
// More planes than there can be through a voxel: whether it is free is worked out for it alone.
constexpr std::uint8_t kAskItself = 128;

void mark_free(int x, int y, int z, BlockEvidence& evidence) {
  evidence.free[static_cast<std::size_t>(y + kBlockEdge * z)] |=
      static_cast<std::uint16_t>(1U << x);
  evidence.any_free = true;
}

void mark_free_cube(int x0, int y0, int z0, int span, BlockEvidence& evidence) {
  const auto run = static_cast<std::uint16_t>(((1U << span) - 1U) << x0);
  for (int z = z0; z < z0 + span; ++z) {
    for (int y = y0; y < y0 + span; ++y) {
      evidence.free[static_cast<std::size_t>(y + kBlockEdge * z)] |= run;
    }
  }
  evidence.any_free = true;
}

const double kHalfDiagonal = std::sqrt(3.0) / 2;  // of a unit cube

}  // namespace

BlockLooker::BlockLooker(const Fan& fan, const FanSettings& settings, const IwloRule& rule,
                         double edge_m, const Vec3& offset_m)
    : fan_(fan),
      kernels_(kernels()),
      lines_(fan, edge_m, kernels_),
      aggregation_(settings.aggregation),
      edge_m_(edge_m),
      offset_m_(offset_m),
      weight_error_(settings.error_bound / std::max(rule.params().L_occ, 1e-3)) {}

struct BlockLooker::Cell {
  int x;  // of its first voxel, in the block
  int y;
  int z;
  Vec3 centre;
  Fan::Verdict verdict;
  // As a moving sonar sees it; without motion as it is.
  Seen seen;
  Widening widening;

  // A direction of what is seen as one of the map, and where in it a place of the cell is.
  Vec3 of_place(const Vec3& normal) const {
    return widening.stretch > 0 ? seen.axes.of_place(normal) : normal;
  }
  Vec3 seen_from(const Vec3& place) const {
    return widening.stretch > 0 ? seen.at + seen.axes.apply(place - centre) : place;
  }
};

Vec3 BlockLooker::centre_of(const BlockKey& local, double x, double y, double z) const {
  const double block_m = edge_m_ * kBlockEdge;
  return Vec3{local.x * block_m + x * edge_m_, local.y * block_m + y * edge_m_,
              local.z * block_m + z * edge_m_} -
         offset_m_;
}

void BlockLooker::look(const BlockKey& local, BlockEvidence& evidence) const {
  evidence.key = local;
  evidence.free.fill(0);
  evidence.occupied.clear();
  evidence.any_free = false;
  constexpr int kHalf = kBlockEdge / 2;
  for (int octant = 0; octant < 8; ++octant) {
    const int x = (octant & 1) * kHalf;
    const int y = (octant >> 1 & 1) * kHalf;
    const int z = (octant >> 2 & 1) * kHalf;
    const Vec3 centre = centre_of(local, x + kHalf / 2, y + kHalf / 2, z + kHalf / 2);
    const Fan::Verdict verdict = fan_.verdict(centre, kHalf * edge_m_);
    if (verdict.content == Fan::Content::nothing) continue;
    if (verdict.content == Fan::Content::all_free) {
      mark_free_cube(x, y, z, kHalf, evidence);
      continue;
    }
    for (int child = 0; child < 8; ++child) {
      look_at_cell(local, x + (child & 1) * kCell, y + (child >> 1 & 1) * kCell,
                   z + (child >> 2 & 1) * kCell, evidence);
    }
  }
  evidence.occupied.shrink_to_fit();  // it is kept until the whole ping has been looked at
}

void BlockLooker::look_at_cell(const BlockKey& local, int x, int y, int z,
                               BlockEvidence& evidence) const {
  Cell cell{x, y, z, centre_of(local, x + kCell / 2, y + kCell / 2, z + kCell / 2), {}, {}, {}};
  const double cell_m = kCell * edge_m_;
  if (fan_.view() != nullptr) {
    cell.seen = fan_.view()->look(cell.centre);
    cell.widening = fan_.view()->widening(cell.centre, kHalfDiagonal * cell_m);
    cell.verdict = fan_.verdict(cell.seen, cell.widening, cell_m);
  } else {
    cell.verdict = fan_.verdict(cell.centre, cell_m);
  }
  if (cell.verdict.content == Fan::Content::nothing) return;
  if (cell.verdict.content == Fan::Content::all_free) {
    return mark_free_cube(x, y, z, kCell, evidence);
  }
  if (look_between_beams(cell, evidence)) return;
  // There the directions change too much within the cell for one set of widths.
  const bool near = norm(cell.centre) < 5 * cell_m;
  near ? look_near(cell, evidence) : look_far(cell, evidence);
}

// Planes that do not meet inside the voxel, in order of bearing, each from free to not or back.
double BlockLooker::free_part_between(const std::array<std::size_t, kMostChanges>& change,
                                      std::size_t changes, bool first_is_free,
                                      const Cube& cube) const {
  double part = first_is_free ? 1.0 : 0.0;
  double sign = first_is_free ? -1.0 : 1.0;
  for (std::size_t c = 0; c < changes; ++c, sign = -sign) {
    const Vec3& n = fan_.edge_normal(change[c]);
    part += sign * part_beyond(cube.of_place(n), dot(n, cube.centre()) / edge_m_);
  }
  return part;
}

// A cell without returns whose beams are each wholly free or wholly not: the edges of shadows. What
// matters are the planes between free beams and others; one plane leaves the half that holds a
// voxel's centre the larger. False for other cells.
bool BlockLooker::look_between_beams(const Cell& cell, BlockEvidence& evidence) const {
  const FanPart& where = cell.verdict.where;
  if (where.cut_by_aperture || where.cut_by_sides ||
      fan_.any_return(where.first_beam, where.last_beam, where.near_m, where.far_m)) {
    return false;
  }
  const auto is_free = [&](std::size_t j) { return fan_.free_limit_m(j) >= where.far_m; };
  std::array<std::size_t, kMostChanges> change{};
  std::size_t changes = 0;
  for (std::size_t j = where.first_beam; j <= where.last_beam; ++j) {
    if (!is_free(j) && fan_.free_limit_m(j) > where.near_m) return false;
    if (j == where.first_beam || is_free(j) == is_free(j - 1)) continue;
    if (changes == kMostChanges) return false;
    change[changes++] = j;
  }
  std::array<std::uint8_t, kCellVoxels> beyond{};  // planes on whose far side the centre is
  std::array<std::uint8_t, kCellVoxels> cut{};     // planes that cut the voxel
  std::array<std::uint8_t, kCellVoxels> halved{};  // whether one runs through the centre
  const Vec3 first = cell.seen_from(voxel_centre(cell, 0));
  // What a moving sonar sees is known to this, from one linear function for the whole cell.
  const double unsure = cell.widening.bend;
  for (std::size_t c = 0; c < changes; ++c) {
    const double base = dot(fan_.edge_normal(change[c]), first);
    const Vec3 n = cell.of_place(fan_.edge_normal(change[c]));
    const double reach = 0.5 * edge_m_ * (std::abs(n.x) + std::abs(n.y) + std::abs(n.z)) + unsure;
    for (std::size_t i = 0; i < kCellVoxels; ++i) {
      const auto x = static_cast<double>(i % kCell);
      const auto y = static_cast<double>(i / kCell % kCell);
      const auto z = static_cast<double>(i / (kCell * kCell));
      const double inside = base + edge_m_ * (n.x * x + n.y * y + n.z * z);
      beyond[i] = static_cast<std::uint8_t>(beyond[i] + (inside > 0 ? 1 : 0));
      cut[i] = static_cast<std::uint8_t>(cut[i] + (std::abs(inside) < reach ? 1 : 0));
      if (std::abs(inside) >= kTie * edge_m_ + unsure) continue;
      unsure > 0 ? cut[i] = kAskItself : halved[i] = 1;
    }
  }
  const bool first_is_free = is_free(where.first_beam);
  for (std::size_t i = 0; i < kCellVoxels; ++i) {
    // Just half is not more than half.
    bool free = halved[i] == 0 && first_is_free != (beyond[i] % 2 != 0);
    if (cut[i] > 1) {
      SeenAxes axes;
      const Cube cube = cube_at(voxel_centre(cell, static_cast<int>(i)), axes);
      free = free_part_between(change, changes, first_is_free, cube) > kFreePart + kTie;
    }
    if (!free) continue;
    const auto at = static_cast<int>(i);
    mark_free(cell.x + at % kCell, cell.y + at / kCell % kCell, cell.z + at / (kCell * kCell),
              evidence);
  }
  return true;
}

void BlockLooker::look_near(const Cell& cell, BlockEvidence& evidence) const {
  for (int i = 0; i < kCellVoxels; ++i) {
    const int x = i % kCell;
    const int y = i / kCell % kCell;
    const int z = i / (kCell * kCell);
    const Vec3 centre = voxel_centre(cell, i);
    SeenAxes axes;
    settle(fan_.verdict(centre, edge_m_), cube_at(centre, axes),
           voxel_offset(cell.x + x, cell.y + y, cell.z + z), evidence);
  }
}

// One set of widths for the whole cell; what is the same for many of its voxels is asked once.
void BlockLooker::look_far(const Cell& cell, BlockEvidence& evidence) const {
  CellPlaces at;
  places(cell, at);
  const Fan::Extent extent = fan_.extent_in_cell(fan_.to_sonar(cell.seen_from(cell.centre)),
                                                 edge_m_, kCell, cell.widening);
  const FanPart& where = cell.verdict.where;
  const double least_free = fan_.least_free_m(where.first_beam, where.last_beam);
  const double most_free = fan_.most_free_m(where.first_beam, where.last_beam);
  const bool straight = weight_error_ > 0 && cell.widening.bend <= kStraight * edge_m_;
  for (int i = 0; i < kCellVoxels; ++i) {
    const double near_m = at.range[i] - extent.inward;
    const double far_m = at.range[i] + extent.outward;
    if (at.inside_aperture[i] < -extent.aperture || at.inside_sides[i] < -extent.level) continue;
    const int x = cell.x + i % kCell;
    const int y = cell.y + i / kCell % kCell;
    const int z = cell.z + i / (kCell * kCell);
    const bool clear =
        far_m <= least_free && near_m >= fan_.min_range_m() && at.inside_sides[i] >= extent.level;
    if (clear && at.inside_aperture[i] > extent.bend) {
      mark_free(x, y, z, evidence);
      continue;
    }
    if (clear && at.inside_aperture[i] < -extent.bend) continue;
    if (near_m >= most_free && !fan_.any_return(where.first_beam, where.last_beam,
                                                near_m + extent.cap, far_m - extent.cap)) {
      continue;
    }
    const Fan::Place place{at.range[i], at.horizontal[i], at.sine[i], at.inside_aperture[i],
                           at.inside_sides[i]};
    SeenAxes axes;
    const Vec3 centre = voxel_centre(cell, i);
    const Cube cube = straight ? cube_in(cell, centre) : cube_at(centre, axes);
    settle(fan_.verdict(cube.centre(), place, extent, cube.seen), cube, voxel_offset(x, y, z),
           evidence);
  }
}

void BlockLooker::places(const Cell& cell, CellPlaces& at) const {
  const Vec3 first = cell.seen_from(voxel_centre(cell, 0));
  const auto along = [&](const Vec3& direction) {  // a function of the voxel's place
    const Vec3 n = cell.of_place(direction);
    return CellLine{dot(direction, first), {n.x * edge_m_, n.y * edge_m_, n.z * edge_m_}};
  };
  const CellTask task{along(fan_.to_map({1, 0, 0})), along(fan_.to_map({0, 1, 0})),
                      along(fan_.to_map({0, 0, 1})), along(fan_.low_side()),
                      along(fan_.high_side()),       fan_.sin_half_aperture(),
                      fan_.cos_half_aperture()};
  kernels_.places(task, at);
}

Vec3 BlockLooker::voxel_centre(const Cell& cell, int i) const {
  const auto shift = [this](int at) { return (at + 0.5 - kCell / 2) * edge_m_; };
  return cell.centre + Vec3{shift(i % kCell), shift(i / kCell % kCell), shift(i / (kCell * kCell))};
}

// As the sonar sees a voxel, which keeps a pointer to `axes` then.
Cube BlockLooker::cube_at(const Vec3& centre, SeenAxes& axes) const {
  if (fan_.view() == nullptr) return {{centre.x, centre.y, centre.z}, edge_m_ / 2};
  const Seen seen = fan_.view()->look(centre);
  axes = seen.axes;
  return {{seen.at.x, seen.at.y, seen.at.z}, edge_m_ / 2, &axes};
}

// The same by what its cell is seen as, which has to last as long.
Cube BlockLooker::cube_in(const Cell& cell, const Vec3& centre) const {
  if (fan_.view() == nullptr) return {{centre.x, centre.y, centre.z}, edge_m_ / 2};
  const Vec3 at = cell.seen.at + cell.seen.axes.apply(centre - cell.centre);
  return {{at.x, at.y, at.z}, edge_m_ / 2, &cell.seen.axes};
}

void BlockLooker::settle(const Fan::Verdict& verdict, const Cube& cube, int offset,
                         BlockEvidence& evidence) const {
  switch (verdict.content) {
    case Fan::Content::nothing:
    case Fan::Content::less_free:
      return;
    case Fan::Content::mostly_free:
    case Fan::Content::all_free:
      return mark_free(offset % kBlockEdge, offset / kBlockEdge % kBlockEdge, offset / kBlockRows,
                       evidence);
    case Fan::Content::undecided:
      break;
  }
  Evidence sum;
  if (!(weight_error_ > 0 && sampled(cube, verdict.where, sum))) sum = exact(cube, verdict.where);
  decide(sum, offset, evidence);
}

Evidence BlockLooker::exact(const Cube& cube, const FanPart& where) const {
  const Two occupied = occupied_part(fan_, cube, where);
  Evidence sum{occupied.part, occupied.weight, 0.0};
  if (aggregation_ == Aggregation::mean || occupied.part < kOccupiedPart) {
    sum.free = free_part(fan_, cube, where);
  }
  return sum;
}

// As few lines as the bound allows; false where the most do not suffice.
bool BlockLooker::sampled(const Cube& cube, const FanPart& where, Evidence& sum) const {
  LineTask task;
  if (!lines_.prepare(cube, where, task)) return false;
  // The mean of both kinds of evidence depends on the parts themselves.
  if (aggregation_ == Aggregation::mean && task.any_return && may_be_free(task)) return false;
  for (int lines = kFewestLines; lines <= kMostLines;) {
    const VoxelLines::Sample sample = lines_.sample(task, lines);
    const int needed = lines_for(sample, task.any_return);
    if (needed <= lines) {
      sum = sample.sum;
      return true;
    }
    lines = needed;
  }
  return false;
}

bool BlockLooker::may_be_free(const LineTask& task) {
  return std::any_of(task.beam, task.beam + task.beams,
                     [](const LineBeam& beam) { return beam.free_row > 0; });
}

int BlockLooker::lines_for(const VoxelLines::Sample& sample, bool any_return) const {
  const Evidence& sum = sample.sum;
  const bool unclear = any_return ? sum.occupied < kOccupiedPart + kUnclear
                                  : std::abs(sum.free - kFreePart) < kUnclear;
  int lines = unclear ? kLinesIfUnclear : kFewestLines;
  if (!(sum.occupied > 0)) return lines;
  // kSpread sigma / (lines sqrt(occupied)) against the bound, squared.
  const double variance = sample.squared / sum.occupied - sum.weight() * sum.weight();
  const double needed = kSpread * kSpread * variance;
  const double allowed = weight_error_ * weight_error_ * sum.occupied;
  while (lines <= kMostLines && needed > allowed * (lines * lines)) lines *= 2;
  return lines;
}

void BlockLooker::decide(const Evidence& sum, int offset, BlockEvidence& evidence) const {
  if (sum.occupied >= kOccupiedPart) {
    evidence.occupied.push_back({static_cast<float>(std::clamp(sum.weight(), 0.0, 1.0)),
                                 static_cast<float>(sum.occupied / (sum.occupied + sum.free)),
                                 static_cast<std::uint16_t>(offset)});
  } else if (sum.free > kFreePart) {
    mark_free(offset % kBlockEdge, offset / kBlockEdge % kBlockEdge, offset / kBlockRows, evidence);
  }
}

}  // namespace mapperd::map
