// Readers while somebody writes. ThreadSanitizer watches it (scripts/cpp-test tsan); without it the
// test still sees that every answer is of one whole state of the map.
#include <algorithm>
#include <atomic>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "mapperd/map/brick.hpp"
#include "mapperd/map/distance_field.hpp"
#include "mapperd/map/evidence_integrator.hpp"
#include "mapperd/map/map_file.hpp"
#include "mapperd/map/merge.hpp"
#include "mapperd/map/octomap_file.hpp"
#include "mapperd/map/point_updates.hpp"
#include "mapperd/map/queries.hpp"
#include "mapperd/map/rays.hpp"
#include "mapperd/map/snapshot.hpp"
#include "mapperd/map/stream_view.hpp"
#include "scenes.hpp"
#include "testing.hpp"

namespace {

using mapperd::Vec3;
using mapperd::map::KnownVoxel;
using mapperd::map::Occupancy;
using mapperd::map::Points;
using mapperd::map::VoxelMap;

constexpr double kResolution = 0.1;
constexpr mapperd::map::Thresholds kThresholds{0.8, -0.8};

// Two voxels far from each other and from the pings, which every write sets to one value.
constexpr double kTwins[] = {30.05, 0.05, 0.05, -30.05, 0.05, 0.05};
constexpr Points kTwinPoints{kTwins, 2};

// Something is written, again and again, while three threads read all the time.
void run(VoxelMap& map, int writes, const std::function<void(int)>& write,
         const std::vector<std::function<bool()>>& reads) {
  std::atomic<bool> done{false};
  std::atomic<int> wrong{0};
  std::vector<std::thread> readers;
  for (std::size_t r = 0; r < 3; ++r) {
    readers.emplace_back([&, r] {
      for (std::size_t turn = r; !done || turn < r + reads.size(); ++turn) {
        if (!reads[turn % reads.size()]()) ++wrong;
      }
    });
  }
  for (int i = 0; i < writes; ++i) write(i);
  done = true;
  for (std::thread& reader : readers) reader.join();
  CHECK(wrong == 0);
  CHECK(known_count(map) == map.known_count());
}

bool twins_agree(const VoxelMap& map) {
  const auto states = states_at(map, kTwinPoints);
  return states[0].log_odds == states[1].log_odds && states[0].count == states[1].count;
}

bool sizes_agree(const VoxelMap& map) {
  const mapperd::map::MapSize size = size_of(map);
  return size.known_voxels <= size.blocks * mapperd::map::kBlockVoxels && size.memory_bytes > 0 &&
         known_count(map) <= 4000 * mapperd::map::kBlockVoxels;
}

// Every kind of question.
std::vector<std::function<bool()>> all_reads(const VoxelMap& map) {
  const mapperd::map::VoxelBox box = box_of(map, {-2, -2, -2}, {2, 2, 2});
  static const double kRay[] = {0, 0, 0, 1, 0.2, 0.1};
  return {
      [&map] { return twins_agree(map); },
      [&map] { return sizes_agree(map); },
      [&map, box] { return classify_box(map, box, kThresholds).size() == box.count(); },
      [&map] {
        const auto both = classify(map, kTwinPoints, kThresholds);
        return both[0] == both[1];
      },
      [&map] { return ray_cast_depth(map, {kRay, 1}, {kRay + 3, 1}, 5.0, 0.8)[0] >= -1; },
      [&map, box] { return distance_field(map, box, 0.5, 0.8).size() == box.count(); },
      [&map, box] { return occupied_in(map, box, 0.8).size() <= box.count(); },
      [&map] {
        const auto counts = count_classes(map, kThresholds);
        return counts.occupied + counts.free + counts.uncertain <=
               4000 * mapperd::map::kBlockVoxels;
      },
      [&map] { return voxels_between(map, 0.8, 200).size() < 4000 * mapperd::map::kBlockVoxels; },
      [&map] { return dense_blocks(map, 1, 2).keys.size() <= 2; },
      [&map] {
        std::size_t blocks = 0;
        for_dense_blocks(map, 7, [&](const auto& dense) { blocks += dense.keys.size(); });
        return blocks <= 4000;
      },
      [&map] {  // the twins, as the map stream encodes them
        const mapperd::map::StreamView view{1, mapperd::map::StreamDetail::kCounts, 0.25,
                                            kThresholds};
        const auto result = stream_blocks(map, view, {{18, 0, 0}, {-19, 0, 0}});
        const auto first = result.cells.begin(), second = first + mapperd::map::kStreamCells;
        const auto digests = stream_digests(map, view, {{18, 0, 0}}).digests;
        return std::count(first, second, -128) == std::count(second, result.cells.end(), -128) &&
               digests.size() == 1 && changed_blocks(map, 0, {}).keys.size() <= 4000;
      },
      [&map] { return !octomap_ot(map).empty() && !octomap_bt(map, 0.8, -0.8).empty(); },
      [&map] {
        VoxelMap loaded(kResolution, {});
        load_map(encode_map(map), loaded);
        return twins_agree(loaded);
      },
      [&map] { return with_rule(map, {}).resolution_m() == kResolution; },
      [&map] {
        VoxelMap sum(kResolution, {});
        merge(sum, {&map});
        return twins_agree(sum);
      },
  };
}

// Every kind of change, each leaving the twins alike.
class Writes {
 public:
  Writes() : other_(kResolution, {}) {
    const std::vector<double> values(2, 0.5);
    set_log_odds(other_, kTwinPoints, values.data());
    file_ = octomap_ot(other_);
  }

  std::vector<std::function<void(VoxelMap&)>> all() {
    return {
        [this](VoxelMap& map) { integrate_evidence_grid(map, next_ping().image(), pose_, {}); },
        [this](VoxelMap& map) {
          mapperd::map::PingParams shared;
          shared.threads = 2;
          shared.carve_no_return = true;
          integrate_evidence_grid(map, next_ping().image(), pose_, shared);
        },
        [this](VoxelMap& map) { integrate_rays(map, next_ping().image(), pose_, {}); },
        [this](VoxelMap& map) { set_log_odds(map, kTwinPoints, next_values()); },
        [this](VoxelMap& map) { add_log_odds(map, kTwinPoints, next_values(), {-2, 3.5}); },
        [this](VoxelMap& map) {
          const double bright[] = {200, 200};
          const bool flags[] = {true, true};
          observe(map, {kTwinPoints, bright, flags, nullptr});
        },
        [](VoxelMap& map) { add_ray(map, {0, 0, 0}, {1, 2, 3}, 0.85, -0.4, {-2, 3.5}); },
        [this](VoxelMap& map) { merge(map, {&other_}); },
        [this](VoxelMap& map) { load_octomap(file_, map); },
        [this](VoxelMap& map) { load_map(encode_map(other_), map); },
        [](VoxelMap& map) { clear(map); },
    };
  }

 private:
  const scenes::Ping& next_ping() {
    ping_ = scenes::random_ping(random_);
    pose_ = scenes::random_pose(random_);
    pose_.translation = {};
    return ping_;
  }
  const double* next_values() {
    values_.assign(2, random_.uniform(-5, 5));
    return values_.data();
  }

  scenes::Random random_{11};
  scenes::Ping ping_;
  mapperd::Transform pose_;
  std::vector<double> values_;
  VoxelMap other_;
  std::string file_;
};

TEST_CASE("every kind of reader sees whole states while everything is written") {
  VoxelMap map(kResolution, {});
  Writes writes;
  const auto kinds = writes.all();
  run(
      map, 198, [&](int i) { kinds[static_cast<std::size_t>(i) % kinds.size()](map); },
      all_reads(map));
}

TEST_CASE("every kind of writer, while points are looked up") {
  Writes writes;
  for (const auto& write : writes.all()) {
    VoxelMap map(kResolution, {});
    const double ray[] = {0.01, 0.01, 0.01, 0.5, 1.0, 1.5};
    const auto looks = std::vector<std::function<bool()>>{
        [&map] { return twins_agree(map); },
        [&map, &ray] { return states_at(map, {ray, 2}).size() == 2; },
        [&map] { return sizes_agree(map); },
    };
    run(map, 40, [&](int) { write(map); }, looks);
  }
}

TEST_CASE("a crowd of readers does not keep the writer out") {
  VoxelMap map(kResolution, {});
  const auto reads = std::vector<std::function<bool()>>(3, [&map] { return twins_agree(map); });
  int writes = 0;
  run(
      map, 500,
      [&](int i) {
        const std::vector<double> values(2, i % 10 - 4.5);
        set_log_odds(map, kTwinPoints, values.data());
        ++writes;
      },
      reads);
  CHECK(writes == 500);
}

TEST_CASE("maps merged into each other at once, and in a ring, do not wait for ever") {
  VoxelMap a(kResolution, {}), b(kResolution, {}), c(kResolution, {});
  const std::vector<double> ones(2, 1.0);
  for (VoxelMap* map : {&a, &b, &c}) set_log_odds(*map, kTwinPoints, ones.data());
  const auto merging = [](VoxelMap& into, std::vector<const VoxelMap*> others) {
    return std::thread([&into, others] {
      for (int i = 0; i < 200; ++i) merge(into, others);
    });
  };
  std::vector<std::thread> threads;
  threads.push_back(merging(a, {&b, &c, &b}));  // one may be named twice
  threads.push_back(merging(b, {&a}));
  threads.push_back(merging(c, {&a, &b}));
  for (std::thread& thread : threads) thread.join();
  for (const VoxelMap* map : {&a, &b, &c}) {
    CHECK(states_at(*map, kTwinPoints)[0].log_odds == 10.0F);
    CHECK(twins_agree(*map));
  }
}

TEST_CASE("tiles come and go whole while threads read") {
  VoxelMap map(kResolution, {});
  map.cut_into_tiles({mapperd::map::kBrickEdge, [](const std::vector<mapperd::map::BlockKey>&) {}});
  const std::vector<mapperd::map::BlockKey> tiles{{4, 0, 0}, {-5, 0, 0}};  // with one twin each
  put_bricks(map, {}, tiles);
  set_log_odds(map, kTwinPoints, std::vector<double>(2, 2.0).data());
  const mapperd::map::ChangedBricks kept = bricks_since(map, 0);
  CHECK(kept.bricks.size() == 2);
  const auto all_or_none = [&map] {
    const std::size_t known = size_of(map).known_voxels;
    return known == 0 || known == 2;
  };
  run(map, 300,
      [&](int i) {
        if (i % 2 == 0) return drop_tiles(map, tiles);
        std::vector<mapperd::map::BrickView> bricks;
        for (const mapperd::map::Brick& brick : kept.bricks)
          bricks.push_back({brick.key, brick.bytes});
        put_bricks(map, bricks, tiles);
      },
      {all_or_none, [&map] { return twins_agree(map); },
       [&map] { return bricks_since(map, 0).bricks.size() % 2 == 0; }});
  CHECK(size_of(map).known_voxels == 2);
}

}  // namespace
