// Log-odds in an OpenVDB grid, rays walked with OpenVDB's DDA. Two ways that its users write:
//   visits  every ray changes every voxel that it passes, so voxels near the sonar change often;
//   once    the rays of a ping mark voxels in masks first, then each changes once (as OctoMap's).
// Both walk one ray for each distinct end voxel, and keep hold of the leaf that they are in.
#include <openvdb/math/DDA.h>
#include <openvdb/math/Ray.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <string>
#include <vector>

#include "run.hpp"

namespace {

using openvdb::Coord;
using openvdb::FloatGrid;
using openvdb::FloatTree;
using openvdb::MaskTree;
using openvdb::Vec3d;
using Ray = openvdb::math::Ray<double>;

// Cells, not centres, are whole numbers: a point's voxel is its floor.
Vec3d cells_of(double x, double y, double z, double resolution_m) {
  return Vec3d(x, y, z) / resolution_m;
}

std::vector<Coord> end_voxels(const RayPing& ping, double resolution_m) {
  std::vector<Coord> ends;
  ends.reserve(ping.ends_m.size());
  for (const auto& end : ping.ends_m) {
    ends.push_back(
        Coord::floor(cells_of(double{end[0]}, double{end[1]}, double{end[2]}, resolution_m)));
  }
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  return ends;
}

// Calls visit(voxel) for the voxels from the origin's up to, and without, the end's.
template <typename Visit>
void walk(const Vec3d& origin, const Coord& end, const Visit& visit) {
  const Vec3d middle = end.asVec3d() + Vec3d(0.5);
  if (Coord::floor(origin) == end) return;
  openvdb::math::DDA<Ray> dda(Ray(origin, middle - origin, 0.0, 1.0));
  do {
    if (dda.voxel() == end) return;
    visit(dda.voxel());
  } while (dda.step());
}

// Remembers the leaf that it touched last.
template <typename Tree>
class LeafCursor {
 public:
  explicit LeafCursor(Tree& tree) : accessor_(tree) {}

  typename Tree::LeafNodeType& at(const Coord& voxel) {
    const Coord corner = voxel & ~(Tree::LeafNodeType::DIM - 1);
    if (leaf_ == nullptr || corner != corner_) {
      leaf_ = accessor_.touchLeaf(voxel);
      corner_ = corner;
    }
    return *leaf_;
  }

 private:
  openvdb::tree::ValueAccessor<Tree> accessor_;
  typename Tree::LeafNodeType* leaf_ = nullptr;
  Coord corner_;
};

void mark(const RayPing& ping, double resolution_m, MaskTree& free, MaskTree& occupied) {
  const auto& o = ping.origin_m;
  const Vec3d origin = cells_of(o[0], o[1], o[2], resolution_m);
  LeafCursor<MaskTree> free_leaf(free);
  LeafCursor<MaskTree> occupied_leaf(occupied);
  for (const Coord& end : end_voxels(ping, resolution_m)) {
    walk(origin, end, [&](const Coord& voxel) {
      free_leaf.at(voxel).setValueOn(MaskTree::LeafNodeType::coordToOffset(voxel));
    });
    occupied_leaf.at(end).setValueOn(MaskTree::LeafNodeType::coordToOffset(end));
  }
}

float stepped(float log_odds, float step) { return std::clamp(log_odds + step, kMin, kMax); }

void add(const MaskTree& marked, float step, FloatTree& map) {
  openvdb::tree::ValueAccessor<FloatTree> accessor(map);
  for (auto leaf = marked.cbeginLeaf(); leaf; ++leaf) {
    FloatTree::LeafNodeType& target = *accessor.touchLeaf(leaf->origin());
    for (auto on = leaf->getValueMask().beginOn(); on; ++on) {
      target.setValueOn(on.pos(), stepped(target.getValue(on.pos()), step));
    }
  }
}

void insert_once(const RayPing& ping, double resolution_m, FloatTree& map) {
  MaskTree free;
  MaskTree occupied;
  mark(ping, resolution_m, free, occupied);
  free.topologyDifference(occupied);
  add(free, kMiss, map);
  add(occupied, kHit, map);
}

void insert_visits(const RayPing& ping, double resolution_m, FloatTree& map) {
  const auto& o = ping.origin_m;
  const Vec3d origin = cells_of(o[0], o[1], o[2], resolution_m);
  openvdb::tree::ValueAccessor<FloatTree> accessor(map);
  for (const Coord& end : end_voxels(ping, resolution_m)) {
    walk(origin, end, [&](const Coord& voxel) {
      accessor.modifyValue(voxel, [](float& log_odds) { log_odds = stepped(log_odds, kMiss); });
    });
    accessor.modifyValue(end, [](float& log_odds) { log_odds = stepped(log_odds, kHit); });
  }
}

std::size_t count_touched(const RayPing& ping, double resolution_m) {
  MaskTree free;
  MaskTree occupied;
  mark(ping, resolution_m, free, occupied);
  free.topologyUnion(occupied);
  return free.activeVoxelCount();
}

void measure(const std::string& rays, double resolution_m, double budget_ms,
             const std::string& way) {
  openvdb::initialize();
  const FloatGrid::Ptr grid = FloatGrid::create(0.0F);
  FloatTree& map = grid->tree();
  Contender contender;
  contender.insert = [&](const RayPing& ping) {
    (way == "once" ? insert_once : insert_visits)(ping, resolution_m, map);
  };
  contender.count_touched = [&](const RayPing& ping) { return count_touched(ping, resolution_m); };
  contender.memory_bytes = [&] { return map.memUsage(); };
  contender.known_voxels = [&] { return map.activeVoxelCount(); };
  run(contender, read_rays(rays), budget_ms);
}

}  // namespace

int main(int argc, char** argv) { return contender_main(argc, argv, {"visits", "once"}, measure); }
