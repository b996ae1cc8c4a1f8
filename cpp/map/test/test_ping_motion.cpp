// Where a moving sonar sees a place: against poses in time, and the bounds that the walk relies on.
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/map/ping_motion.hpp"
#include "mapperd/map/rays.hpp"
#include "oracle_motion.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Transform;
using mapperd::Vec3;
using mapperd::map::CellPoints;
using mapperd::map::MotionBound;
using mapperd::map::MovingView;
using mapperd::map::PingMotion;
using mapperd::map::Seen;

struct Scene {
  PingMotion motion;
  Transform map_T_sonar;  // at transmission
  MovingView view;
  oracle::Track track;
};

// From slow ones to the limits: a fiftieth of the speed of sound, a radian at 50 m.
Scene scene_of(scenes::Random& random) {
  const double part = std::pow(random.uniform(0, 1), 3);
  PingMotion motion =
      scenes::motion_of(30 * part * random.uniform(0, 1), 15 * part * random.uniform(0, 1), random);
  const Transform pose = scenes::random_pose(random);
  const oracle::Track track(pose, motion);
  Transform start = mapperd::map::turned_to_transmission(pose, motion);
  start.translation = pose.translation - motion.valid_s * motion.linear_mps;
  return {motion, start, MovingView(motion, start), track};
}

void check_near(const Vec3& a, const Vec3& b, double tolerance) {
  CHECK(norm(a - b) == near(0.0, tolerance));
}

TEST_CASE("a moving sonar sees a place where poses in time put it") {
  scenes::Random random(901);
  for (int i = 0; i < 2000; ++i) {
    const Scene scene = scene_of(random);
    const Vec3 place = random.uniform(0.01, 50) * scenes::random_direction(random);
    const Vec3 seen = scene.view.seen(place);
    const auto heard = scene.track.heard(place + scene.map_T_sonar.translation);
    const Vec3 expected = scene.map_T_sonar.rotate(
        mapperd::map::fan_point(heard.range_m, heard.bearing_rad, heard.elevation_rad));
    check_near(seen, expected, 1e-10);
    check_near(scene.view.look(place).at, seen, 1e-12);
    check_near(scene.view.place_of(seen), place, 1e-10);
    check_near(scene.track.point(heard) - scene.map_T_sonar.translation, place, 1e-9);
  }
}

TEST_CASE("a turn of any size is right to the last digits") {
  // Of unit vectors about z, small and large: each size is worked out in its own way.
  for (const double angle : {0.0, 1e-9, 1e-3, 0.02, 0.0316, 0.0317, 0.3, 0.99, 1.01, 3.0}) {
    const Transform turned =
        mapperd::map::turned_to_transmission({}, {{}, {0, 0, angle}, 1.0, 1500.0});
    const Vec3 expected{std::cos(angle), std::sin(angle), 0};
    check_near(turned.rows[0], expected, 5e-16);
  }
}

TEST_CASE("sign and size of each motion, worked out by hand") {
  // 30 m ahead of a level sonar that looks along x: 40 ms there and back.
  const Vec3 ahead{30, 0, 0};
  const auto seen = [&](const Vec3& linear, const Vec3& angular) {
    return MovingView({linear, angular, 0.0, 1500.0}, {}).seen(ahead);
  };
  // Towards it at 1.5 m/s: 30 mm nearer at half time. Sideways to port, it is 60 mm to starboard.
  check_near(seen({1.5, 0, 0}, {}), {29.97, 0, 0}, 1e-4);
  check_near(seen({0, 1.5, 0}, {}), {30, -0.06, 0}, 1e-4);
  // Turning to port at 0.5 rad/s it comes to lie 20 mrad to starboard, at 0.6 m.
  check_near(seen({}, {0, 0, 0.5}), {30 * std::cos(0.02), -30 * std::sin(0.02), 0}, 1e-9);
  check_near(seen({}, {0, 0.5, 0}), {30 * std::cos(0.02), 0, 30 * std::sin(0.02)}, 1e-9);
  check_near(seen({}, {0.5, 0, 0}), ahead, 1e-12);
}

TEST_CASE("without motion a place is seen where it is") {
  scenes::Random random(902);
  const MovingView still({{}, {}, 0.0, 1500.0}, scenes::random_pose(random));
  for (int i = 0; i < 100; ++i) {
    const Vec3 place = random.uniform(0.1, 50) * scenes::random_direction(random);
    check_near(still.seen(place), place, 1e-13);
    const MotionBound none = still.motion_bound(place, 0.5);
    CHECK((none.stretch == 0 && none.bend == 0));
  }
  check_near(still.seen({}), {}, 0.0);
}

TEST_CASE("places that are seen together are seen as each alone, to the bit") {
  scenes::Random random(904);
  for (int i = 0; i < 500; ++i) {
    const Scene scene = scene_of(random);
    const double far = 50 * std::pow(random.uniform(0, 1), 3);  // a small turn near, a large one
    CellPoints together;
    for (std::size_t k = 0; k < CellPoints::kCount; ++k) {
      together.set(k, far * random.uniform(0, 1) * scenes::random_direction(random));
    }
    together.set(5, {});
    const CellPoints places = together;
    scene.view.see(together);
    for (std::size_t k = 0; k < CellPoints::kCount; ++k) {
      const Vec3 alone = scene.view.seen(places.at(k));
      CHECK((together.x[k] == alone.x && together.y[k] == alone.y && together.z[k] == alone.z));
    }
  }
}

Vec3 towards(const MovingView& view, const Vec3& place, const Vec3& step) {
  return 0.5 * (view.seen(place + step) - view.seen(place - step));
}

TEST_CASE("axes are the slopes of what is seen, and the bounds hold") {
  scenes::Random random(903);
  double fullest_stretch = 0;
  double fullest_bend = 0;
  for (int i = 0; i < 4000; ++i) {
    const Scene scene = scene_of(random);
    const double distance = 40 * std::pow(random.uniform(0.1, 1), 3);
    const Vec3 place = distance * scenes::random_direction(random);
    const Seen seen = scene.view.look(place);
    const double h = 1e-4 * distance;
    check_near((1 / h) * towards(scene.view, place, {h, 0, 0}), seen.axes.x, 1e-7);
    check_near((1 / h) * towards(scene.view, place, {0, h, 0}), seen.axes.y, 1e-7);
    check_near((1 / h) * towards(scene.view, place, {0, 0, h}), seen.axes.z, 1e-7);
    const double radius = distance * random.uniform(0.01, 1.2);
    const MotionBound bound = scene.view.motion_bound(place, radius);
    for (int k = 0; k < 20; ++k) {
      const Vec3 shift = radius * random.uniform(0, 1) * scenes::random_direction(random);
      const Vec3 moved = scene.view.seen(place + shift) - seen.at;
      const double bend = norm(moved - seen.axes.apply(shift));
      const double stretch = norm(moved - shift) / radius;
      CHECK((bend <= bound.bend && stretch <= bound.stretch));
      fullest_bend = std::max(fullest_bend, bend / bound.bend);
      fullest_stretch = std::max(fullest_stretch, stretch / bound.stretch);
    }
  }
  std::printf("  of the bounds: stretch %.2f, bend %.2f\n", fullest_stretch, fullest_bend);
  CHECK((fullest_stretch > 0.3 && fullest_bend > 0.2));  // nor are they far too wide
}

TEST_CASE("invalid motion is refused") {
  const double not_a_number = std::nan("");
  const auto refused = [](const PingMotion& motion) {
    CHECK_THROWS_AS(mapperd::map::check_motion(motion, 30.0), std::invalid_argument);
  };
  refused({{not_a_number, 0, 0}, {}, 0.0, 1500.0});
  refused({{}, {0, not_a_number, 0}, 0.0, 1500.0});
  refused({{}, {}, not_a_number, 1500.0});
  refused({{}, {}, 0.0, 0.0});
  refused({{}, {}, 0.0, not_a_number});
  refused({{0, 0, 31}, {}, 0.0, 1500.0});
  refused({{}, {26, 0, 0}, 0.0, 1500.0});
  refused({{}, {}, 61.0, 1500.0});
  mapperd::map::check_motion({{0, 0, 29}, {24, 0, 0}, 0.02, 1500.0}, 30.0);
}

}  // namespace
