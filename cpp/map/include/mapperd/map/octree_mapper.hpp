/// \file
/// \brief OctreeMapper: occupancy by points and rays, with one probability for hits and one for
/// misses.
///
/// The methods have the names, parameters and defaults of `OctreeMapper` of sonar_3d_reconstruction
/// (octree_mapper.cpp). Points are anything with members x(), y() and z() (Eigen::Vector3d,
/// octomap::point3d); matrices are anything with rows() and (i, j). The namespace and the types of
/// results are this library's own: callers of the original adapt to them. Comments name the defects
/// of the original that this class does not have.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/map/voxel_map.hpp"

namespace mapperd::map {

/// Size of a map in memory.
struct MemoryStats {
  std::size_t num_nodes = 0;       ///< observed voxels, and the blocks of 16^3 that hold them
  std::size_t num_leaf_nodes = 0;  ///< observed voxels
  double memory_mb = 0.0;          ///< really allocated, in 10^6 bytes
  double memory_efficiency = 0.0;  ///< leaf nodes / nodes
};

/// Occupancy of voxels, updated by points and rays.
class OctreeMapper {
 public:
  /// x, y, z of a voxel's centre in metres, and its probability.
  using OccupiedVoxel = std::array<double, 4>;

  /// \param resolution edge of a voxel, m
  /// \throws std::invalid_argument for a resolution or probability out of range
  explicit OctreeMapper(double resolution = 0.05, double prob_hit = 0.7, double prob_miss = 0.3,
                        double prob_thres_min = 0.12, double prob_thres_max = 0.97);

  /// Adds one hit or miss.
  /// \throws std::invalid_argument for a point that is not finite or beyond the map's reach
  template <typename Point>
  void update_point(const Point& point, bool occupied) {
    add_steps({point.x(), point.y(), point.z()}, {occupied});
  }

  /// Adds hits and misses in their order: a voxel named twice takes two steps.
  /// \param points N x 3, m
  /// \throws std::invalid_argument and changes nothing where a point is refused; the original
  ///         dropped such points
  template <typename Matrix>
  void batch_update(const Matrix& points, const std::vector<bool>& occupied_flags) {
    add_steps(coordinates(points), occupied_flags);
  }

  /// Sets log-odds: the values are absolute, not steps, and are clamped to -10..10.
  template <typename Matrix, typename Vector>
  void batch_update_with_log_odds(const Matrix& points, const Vector& log_odds_updates) {
    std::vector<double> values(static_cast<std::size_t>(log_odds_updates.size()));
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = log_odds_updates[static_cast<Index<Vector>>(i)];
    }
    set_values(coordinates(points), values);
  }

  /// Adds a miss to every voxel on the segment, and a hit to that of the end point.
  template <typename Point>
  void insert_ray(const Point& origin, const Point& endpoint) {
    add_segment({origin.x(), origin.y(), origin.z()}, {endpoint.x(), endpoint.y(), endpoint.z()});
  }

  /// Voxels above a probability; a negative one means 0.5. Centres, where the original returned the
  /// voxels' lowest corners.
  std::vector<OccupiedVoxel> get_occupied_voxels(double min_probability = -1.0) const;

  MemoryStats get_memory_usage() const;
  std::size_t get_num_nodes() const { return get_memory_usage().num_nodes; }
  double get_resolution() const { return map_.resolution_m(); }

  /// \throws std::invalid_argument unless 0 < prob_miss <= 0.5 <= prob_hit < 1
  void set_probability_params(double prob_hit, double prob_miss);

  /// Probabilities that hits and misses do not cross. Unlike in the original, `max_thresh` is not
  /// the threshold of being occupied as well.
  /// \throws std::invalid_argument unless 0 < min_thresh < 0.5 < max_thresh < 1
  void set_occupancy_thresholds(double min_thresh, double max_thresh);

  /// Returns 0: space of one state is always kept as one, so there is nothing to prune.
  std::size_t prune_tree() { return 0; }
  void clear();

  /// Writes an OctoMap .bt (classes) or, where the name ends in .ot, log-odds; atomically.
  /// Returns false where the file cannot be written or a voxel lies beyond OctoMap's keys.
  bool save_to_file(const std::string& filename) const;

  /// Replaces the content by that of a .bt or .ot file of the same resolution. Returns false, and
  /// leaves the map as it was, for anything else.
  bool load_from_file(const std::string& filename);

  const VoxelMap& map() const { return map_; }

 private:
  template <typename Container>
  using Index = decltype(std::declval<const Container&>().size());

  template <typename Matrix>
  static std::vector<double> coordinates(const Matrix& points) {
    const auto rows = points.rows();
    std::vector<double> xyz;
    xyz.reserve(3 * static_cast<std::size_t>(rows));
    for (auto i = rows - rows; i < rows; ++i) {
      for (int axis = 0; axis < 3; ++axis) xyz.push_back(points(i, axis));
    }
    return xyz;
  }

  void add_steps(const std::vector<double>& xyz, const std::vector<bool>& occupied);
  void set_values(const std::vector<double>& xyz, const std::vector<double>& log_odds);
  void add_segment(const Vec3& origin_m, const Vec3& end_m);

  VoxelMap map_;
  double hit_ = 0.0;  ///< log-odds, as all below
  double miss_ = 0.0;
  double low_ = 0.0;
  double high_ = 0.0;
};

}  // namespace mapperd::map
