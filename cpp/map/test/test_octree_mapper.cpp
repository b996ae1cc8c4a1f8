#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "mapperd/map/octree_mapper.hpp"
#include "testing.hpp"

namespace {

using mapperd::map::OctreeMapper;

// As Eigen::Vector3d and Eigen::MatrixXd behave.
struct Point {
  double at[3];
  double x() const { return at[0]; }
  double y() const { return at[1]; }
  double z() const { return at[2]; }
};

struct Matrix {
  std::vector<Point> points;
  long rows() const { return static_cast<long>(points.size()); }
  double operator()(long row, int axis) const {
    return points[static_cast<std::size_t>(row)].at[axis];
  }
};

constexpr double kOutside = 1e9;

TEST_CASE("hits and misses add up to the thresholds") {
  OctreeMapper mapper(0.1);
  mapper.update_point(Point{{1.02, 2.02, 3.02}}, true);
  const auto once = mapper.get_occupied_voxels();
  CHECK(once.size() == 1);
  CHECK(once[0][0] == near(1.05, 1e-12));
  CHECK(once[0][2] == near(3.05, 1e-12));
  CHECK(once[0][3] == near(0.7, 1e-3));
  for (int i = 0; i < 50; ++i) mapper.update_point(Point{{1.02, 2.02, 3.02}}, true);
  CHECK(mapper.get_occupied_voxels()[0][3] == near(0.97, 1e-3));
  CHECK(mapper.get_occupied_voxels(0.98).empty());
  for (int i = 0; i < 50; ++i) mapper.update_point(Point{{1.02, 2.02, 3.02}}, false);
  CHECK(mapper.get_occupied_voxels().empty());
  CHECK(mapper.get_occupied_voxels(0.0)[0][3] == near(0.12, 1e-3));
}

TEST_CASE("a batch is taken whole or not at all") {
  OctreeMapper mapper;
  const Matrix bad{{{{0, 0, 0}}, {{kOutside, 0, 0}}}};
  CHECK_THROWS_AS(mapper.batch_update(bad, {true, true}), std::invalid_argument);
  CHECK_THROWS_AS(mapper.batch_update(Matrix{{{{0, 0, 0}}}}, {true, true}), std::invalid_argument);
  CHECK(mapper.get_num_nodes() == 0);
  const Matrix points{{{{0, 0, 0}}, {{1, 0, 0}}, {{2, 0, 0}}}};
  mapper.batch_update(points, {true, false, true});
  CHECK(mapper.get_occupied_voxels().size() == 2);
  mapper.batch_update_with_log_odds(points, std::vector<double>{-3.0, 2.0, 99.0});
  CHECK(mapper.get_occupied_voxels().size() == 2);
  CHECK(mapper.get_occupied_voxels(0.99)[0][3] == near(1.0 / (1.0 + std::exp(-10.0)), 1e-6));
}

TEST_CASE("a ray is free up to its end") {
  OctreeMapper mapper(0.1);
  mapper.insert_ray(Point{{0.05, 0.05, 0.05}}, Point{{1.05, 0.05, 0.05}});
  CHECK(mapper.get_occupied_voxels().size() == 1);
  const auto stats = mapper.get_memory_usage();
  CHECK(stats.num_leaf_nodes == 11);
  CHECK((stats.num_nodes > 11 && stats.memory_efficiency < 1.0 && stats.memory_mb > 0.0));
  CHECK(mapper.prune_tree() == 0);
  mapper.clear();
  CHECK(mapper.get_num_nodes() == 0);
}

TEST_CASE("files come back, and bad ones leave the map alone") {
  const std::string base =
      (std::filesystem::temp_directory_path() / ("octree-mapper-" + std::to_string(getpid())))
          .string();
  OctreeMapper mapper(0.1);
  mapper.insert_ray(Point{{0.05, 0.05, 0.05}}, Point{{1.05, 0.05, 0.05}});
  for (const std::string suffix : {".bt", ".ot"}) {
    const std::string name = base + suffix;
    CHECK(mapper.save_to_file(name));
    OctreeMapper other(0.1);
    CHECK(other.load_from_file(name));
    CHECK(
        (other.get_memory_usage().num_leaf_nodes == 11 && other.get_occupied_voxels().size() == 1));
    OctreeMapper coarse(0.2);
    CHECK((!coarse.load_from_file(name) && coarse.get_num_nodes() == 0));
    std::ofstream(name, std::ios::binary) << "no tree";
    CHECK((!other.load_from_file(name) && other.get_memory_usage().num_leaf_nodes == 11));
    std::remove(name.c_str());
    CHECK(!other.load_from_file(name));
    CHECK(!mapper.save_to_file("/nowhere/at/all" + suffix));
  }
}

TEST_CASE("probabilities out of range are refused") {
  CHECK_THROWS_AS(OctreeMapper(0.0), std::invalid_argument);
  CHECK_THROWS_AS(OctreeMapper(0.1, 0.4), std::invalid_argument);
  CHECK_THROWS_AS(OctreeMapper(0.1, 0.7, 0.6), std::invalid_argument);
  CHECK_THROWS_AS(OctreeMapper(0.1, 0.7, 0.3, 0.6), std::invalid_argument);
  CHECK_THROWS_AS(OctreeMapper(0.1, 0.7, 0.3, 0.1, 1.0), std::invalid_argument);
  CHECK_THROWS_AS(OctreeMapper().get_occupied_voxels(1.5), std::invalid_argument);
}

}  // namespace
