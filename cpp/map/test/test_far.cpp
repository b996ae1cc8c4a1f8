// Ten thousand kilometres from the origin the map is the map at the origin, to the bit.
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "mapperd/map/distance_field.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/point_updates.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/snapshot.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::BlockKey;
using mapperd::map::DenseBlocks;
using mapperd::map::VoxelMap;

// A whole number of blocks, in doubles exactly: block edges of 2 m, and 10 000 km of them. Poses
// are multiples of 2^-20 m, so that adding the distance rounds nothing either.
constexpr double kResolution = 0.125;
constexpr double kFar = 1e7;
constexpr std::int32_t kFarBlocks = 5000000;

double on_grid(double metres) { return std::nearbyint(metres * 0x1p20) * 0x1p-20; }

struct Shift {
  int x, y, z;
  Vec3 metres() const { return {x * kFar, y * kFar, z * kFar}; }
};

const Shift kShifts[] = {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {-1, 1, -1}};

template <typename Integrate>
VoxelMap mapped(const Vec3& shift, const Integrate& integrate) {
  VoxelMap map(kResolution, {});
  scenes::Random random(21);
  for (int i = 0; i < 6; ++i) {
    const scenes::Ping ping = scenes::random_ping(random);
    Transform pose = scenes::random_pose(random);
    const Vec3 near{random.uniform(-3, 3), random.uniform(-3, 3), random.uniform(-3, 3)};
    pose.translation = Vec3{on_grid(near.x), on_grid(near.y), on_grid(near.z)} + shift;
    integrate(map, ping.image(), pose);
  }
  return map;
}

void check_equal_but_shifted(const VoxelMap& near, const VoxelMap& far, const Shift& shift) {
  const DenseBlocks a = dense_blocks(near, 0, near.block_count());
  DenseBlocks b = dense_blocks(far, 0, far.block_count());
  for (BlockKey& key : b.keys) {
    key = {key.x - shift.x * kFarBlocks, key.y - shift.y * kFarBlocks,
           key.z - shift.z * kFarBlocks};
  }
  CHECK(near.known_count() > 1000);
  CHECK((a.keys == b.keys && a.units == b.units && a.counts == b.counts));
}

void project(VoxelMap& map, const mapperd::map::PingImage& image, const Transform& pose) {
  integrate_evidence_grid(map, image, pose, {});
}

TEST_CASE("pings ten thousand kilometres away make the same blocks, projected") {
  const VoxelMap near = mapped({}, project);
  for (const Shift& shift : kShifts) {
    check_equal_but_shifted(near, mapped(shift.metres(), project), shift);
  }
}

TEST_CASE("pings ten thousand kilometres away make the same blocks, by rays") {
  const auto sample = [](VoxelMap& map, const mapperd::map::PingImage& image,
                         const Transform& pose) { integrate_rays(map, image, pose, {}); };
  const VoxelMap near = mapped({}, sample);
  for (const Shift& shift : kShifts) {
    check_equal_but_shifted(near, mapped(shift.metres(), sample), shift);
  }
}

TEST_CASE("questions ten thousand kilometres away have the same answers") {
  const VoxelMap near = mapped({}, project);
  const Vec3 low{-4, -4, -4}, high{4, 4, 4};
  const mapperd::map::Thresholds thresholds{0.5, -0.5};
  scenes::Random random(22);
  std::vector<double> points;
  std::vector<double> directions;
  for (int i = 0; i < 3 * 200; ++i) {
    points.push_back(on_grid(random.uniform(-4, 4)));
    directions.push_back(random.uniform(-1, 1));
  }
  const auto depths = ray_cast_depth(near, {points.data(), 200}, {directions.data(), 200}, 6, 0.5);
  for (const Shift& shift : kShifts) {
    const Vec3 at = shift.metres();
    const VoxelMap far = mapped(at, project);
    std::vector<double> moved = points;
    for (std::size_t i = 0; i < moved.size(); i += 3) {
      moved[i] += at.x;
      moved[i + 1] += at.y;
      moved[i + 2] += at.z;
    }
    const auto near_box = box_of(near, low, high), far_box = box_of(far, low + at, high + at);
    CHECK(near_box.size == far_box.size);
    CHECK(classify_box(near, near_box, thresholds) == classify_box(far, far_box, thresholds));
    CHECK(distance_field(near, near_box, 1.0, 0.5) == distance_field(far, far_box, 1.0, 0.5));
    CHECK(occupied_in(near, near_box, 0.5).size() == occupied_in(far, far_box, 0.5).size());
    CHECK(classify(near, {points.data(), 200}, thresholds) ==
          classify(far, {moved.data(), 200}, thresholds));
    const auto far_depths =
        ray_cast_depth(far, {moved.data(), 200}, {directions.data(), 200}, 6, 0.5);
    CHECK(far_depths == depths);
  }
}

TEST_CASE(
    "where the resolution has no exact double, far pings differ by the pose's rounding alone") {
  // 10 000 km hold a double's steps of 1.9e-9 m, and 0.1 m has no exact double: the sonar comes to
  // lie a little elsewhere in its voxel, and blocks begin a little elsewhere.
  const auto known = [](double shift_m) {
    VoxelMap map(0.1, {});
    scenes::Random random(23);
    for (int i = 0; i < 4; ++i) {
      const scenes::Ping ping = scenes::random_ping(random);
      Transform pose = scenes::random_pose(random);
      pose.translation = {0.03 + shift_m, -0.02, 0.01};
      integrate_evidence_grid(map, ping.image(), pose, {});
    }
    return voxels_between(map, -200, 200);
  };
  const auto near = known(0.0), far = known(kFar);
  CHECK((near.size() == far.size() && near.size() > 1000));
  for (std::size_t i = 0; i < std::min(near.size(), far.size()); ++i) {
    CHECK(far[i].voxel.x - near[i].voxel.x == 100000000);
    CHECK((far[i].voxel.y == near[i].voxel.y && far[i].voxel.z == near[i].voxel.z));
    CHECK(far[i].state.count == near[i].state.count);
    CHECK(far[i].state.log_odds == ::near(near[i].state.log_odds, 1e-5));
  }
}

template <typename Call>
std::string refusal_of(const Call& call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("a pose that would overflow is refused and the map is as before") {
  scenes::Random random(24);
  const scenes::Ping ping = scenes::random_ping(random);
  VoxelMap map = mapped({}, project);
  const auto before = dense_blocks(map, 0, map.block_count());
  const std::uint64_t revision = map.revision();
  const double reach = kResolution * 16 * static_cast<double>(mapperd::map::kMaxBlock);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  for (const double at : {reach, -reach, reach - 1, 1e18, -1e300, nan, infinity, -infinity}) {
    for (int axis = 0; axis < 3; ++axis) {
      Transform pose;
      (axis == 0 ? pose.translation.x : axis == 1 ? pose.translation.y : pose.translation.z) = at;
      const std::string because = std::isfinite(at) ? "beyond the map's reach" : "is not finite";
      const std::string projected =
          refusal_of([&] { integrate_evidence_grid(map, ping.image(), pose, {}); });
      const std::string sampled = refusal_of([&] { integrate_rays(map, ping.image(), pose, {}); });
      CHECK(projected.find(because) != std::string::npos);
      CHECK(sampled == projected);
    }
  }
  for (const double bad : {nan, infinity, 0.0, 2.0}) {
    Transform pose;
    pose.rows[1].y = bad;
    CHECK(!refusal_of([&] { integrate_evidence_grid(map, ping.image(), pose, {}); }).empty());
    CHECK(!refusal_of([&] { integrate_rays(map, ping.image(), pose, {}); }).empty());
  }
  const auto after = dense_blocks(map, 0, map.block_count());
  CHECK(
      (after.keys == before.keys && after.units == before.units && after.counts == before.counts));
  CHECK(map.revision() == revision);
}

TEST_CASE("the last poses and keys inside the reach are taken") {
  scenes::Random random(25);
  const scenes::Ping ping = scenes::random_ping(random);
  const double block_m = kResolution * 16;
  const double last = block_m * (mapperd::map::kMaxBlock - 4.0) - ping.image().max_range_m();
  for (const double side : {1.0, -1.0}) {
    VoxelMap map(kResolution, {});
    Transform pose = scenes::rotation_zyx(side > 0 ? 0.0 : 3.14159, 0, 0);
    pose.translation = {side * last, side * last, side * last};
    integrate_evidence_grid(map, ping.image(), pose, {});
    integrate_rays(map, ping.image(), pose, {});
    CHECK(map.known_count() > 100);
    CHECK(map.at(pose.apply({1.0, 0, 0})).count > 0);
  }
}

TEST_CASE("keys and points beyond the reach are refused, those at its end are not") {
  constexpr std::int32_t last = mapperd::map::kMaxBlock;
  constexpr std::int32_t lowest = std::numeric_limits<std::int32_t>::min();
  VoxelMap map(kResolution, {});
  for (const BlockKey& key :
       {BlockKey{last + 1, 0, 0}, BlockKey{0, -last - 1, 0}, BlockKey{0, 0, lowest}}) {
    CHECK_THROWS_AS(map.get_or_create(key), std::out_of_range);
    CHECK(map.find(key) == nullptr);
  }
  const std::int64_t beyond = (std::int64_t{last} + 1) * 16;
  for (const std::int64_t far : {beyond, -beyond - 1, std::numeric_limits<std::int64_t>::max(),
                                 std::numeric_limits<std::int64_t>::min()}) {
    CHECK_THROWS_AS(map.set({0, far, 0}, {1.0F, 1}), std::out_of_range);
    CHECK(map.at(mapperd::map::VoxelIndex{0, far, 0}).count == 0);
  }
  const double point[] = {0, 0, kResolution * 16.0 * last};
  const double one = 1.0;
  CHECK(refusal_of([&] { set_log_odds(map, {point, 1}, &one); }).find("reach in row 0") !=
        std::string::npos);
  CHECK((map.block_count() == 0 && map.revision() == 0));
  map.set({beyond - 1, -beyond + 16, 0}, {1.0F, 1});
  CHECK(map.at(mapperd::map::VoxelIndex{beyond - 1, -beyond + 16, 0}).log_odds == 1.0F);
  CHECK(map.find({last, -last, 0}) != nullptr);
}

}  // namespace
