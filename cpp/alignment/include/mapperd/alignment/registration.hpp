/// \file
/// \brief Registration of two levelled submaps in x, y and yaw.
///
/// A submap is a small occupancy map in a frame whose z axis is vertical and whose z is absolute:
/// depth, roll and pitch come from sensors. `search_poses` finds candidates in a window by the
/// distances to occupied voxels; `register_submaps` refines one.
///
/// \par Threads
/// Functions of their arguments, and const members: any thread may call them.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "mapperd/common/vec.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::alignment {

using localization::Matrix3;
using localization::Pose2;

inline constexpr double kMaxDistanceM = 1.5;  ///< distances to occupied voxels end here
inline constexpr std::size_t kMaxCells = std::size_t{1} << 27;

/// Weighted mean and covariance (xx, xy, xz, yy, yz, zz) of the occupied voxels around one.
struct Distribution {
  Vec3 mean_m;
  std::array<double, 6> covariance_m2{};
};

/// What a submap holds at a voxel.
struct VoxelView {
  double distance_m;  ///< from its centre to the nearest occupied one, at most kMaxDistanceM
  bool is_free;       ///< it was observed, and is not occupied
};

/// Observed voxels of a part of a dive, with distances and distributions for registration.
class Submap {
 public:
  /// \param occupied, free  centres of voxels, m
  /// \param resolution_m    edge of a voxel
  /// \param weights         of the occupied voxels in the distributions, such as their log-odds
  /// \throws std::invalid_argument without occupied voxels, for centres that are not finite,
  /// weights that are not positive, or where the box of all has more than kMaxCells voxels.
  Submap(const std::vector<Vec3>& occupied, const std::vector<Vec3>& free, double resolution_m,
         const std::vector<double>& weights);

  const std::vector<Distribution>& distributions() const { return distributions_; }
  double resolution_m() const { return resolution_m_; }

  /// Distance to the nearest occupied centre, interpolated; at most kMaxDistanceM.
  /// \param gradient  of the distance, 1; zero beyond the box or the maximum
  double distance_m(const Vec3& point_m, Vec3& gradient) const;
  /// The voxel that holds a point; beyond the box it is far from all, and not free.
  VoxelView voxel_at(const Vec3& point_m) const;
  /// Whether the voxel at a point was observed, or is so near to an occupied one. What lies beyond
  /// the edge of the view has no partner, and must not be pulled to the edge.
  bool was_observed(const Vec3& point_m, double margin_m) const;
  /// Index of the nearest occupied voxel within `reach_m`; -1 without one.
  std::int32_t nearest(const Vec3& point_m, double reach_m) const;

 private:
  std::array<std::int64_t, 3> voxel_of(const Vec3& point_m) const;
  bool contains(const std::array<std::int64_t, 3>& voxel) const;
  std::size_t place(const std::array<std::int64_t, 3>& voxel) const;
  void mark(const std::vector<Vec3>& occupied, const std::vector<Vec3>& free);
  void measure_distances();
  void gather_distributions(const std::vector<double>& weights);

  double resolution_m_;
  std::array<std::int64_t, 3> first_{}, size_{};
  std::vector<std::int32_t> cells_;      // index of an occupied voxel, or kFreeCell, kUnknownCell
  std::vector<std::uint8_t> distances_;  // in units of kMaxDistanceM / 255
  std::vector<Vec3> centres_m_;
  std::vector<Distribution> distributions_;
};

/// Window of a search.
struct SearchWindow {
  Pose2 centre;            ///< target_T_source at the middle
  double half_x_m = 1.0;   ///< half width, m
  double half_y_m = 1.0;   ///< half width, m
  double half_yaw = 0.1;   ///< half width, rad
  double step_m = 0.4;     ///< between tested positions, m
  double step_yaw = 0.05;  ///< between tested headings, rad
};

/// How well two submaps agree at a pose.
struct SubmapAgreement {
  double matched = 0.0;       ///< share of a submap's points that lie on occupied voxels
  double contradicted = 0.0;  ///< share that lie in free space of the other
};

/// A pose and how well the submaps agree there.
struct Candidate {
  Pose2 pose;  ///< target_T_source
  SubmapAgreement agreement;
  double score = 0.0;  ///< matched / (matched + contradicted + a little), 0..1
};

/// Compares occupied voxels of each submap with the observed space of the other, at a pose
/// target_T_source. Unobserved space neither confirms nor contradicts.
/// \param scale_m  distance at which a point counts as half matched
/// \param points   number of points of each submap, evenly over its voxels
Candidate compare_submaps(const Submap& target, const Submap& source, const Pose2& pose,
                          double scale_m, std::size_t points);

/// Returns the best local maxima of `compare_submaps` in the window, the best first.
/// \param count  maximum number of candidates, at least half a window step and one apart
/// \throws std::invalid_argument for a window that is not finite or has over 10^6 poses.
std::vector<Candidate> search_poses(const Submap& target, const Submap& source,
                                    const SearchWindow& window, std::size_t count);

/// Result of a registration.
struct Registration {
  Pose2 pose;             ///< target_T_source
  Matrix3 information{};  ///< of x, y (target axes, m) and yaw (rad): inverse of a covariance
  Matrix3 curvature{};    ///< of the cost: singular along directions that the scene leaves open
  Candidate fit;          ///< agreement at the pose
  bool converged = false;
};

/// Refines a pose: first on the distances to occupied voxels by a robust cost whose scale falls
/// from 1 to 0.3 m, then by matching distributions to distributions (as generalized ICP, Segal,
/// Haehnel and Thrun 2009, in three degrees of freedom). Both submaps are target in turn.
///
/// The covariance is that of correlated residuals (the "sandwich" of Huber 1967 over clusters): the
/// cost's gradient varies between columns of 2 m, so a poor fit has a large covariance.
Registration register_submaps(const Submap& target, const Submap& source, const Pose2& start);

}  // namespace mapperd::alignment
