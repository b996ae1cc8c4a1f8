// One ping made ready for projection: beam edges, first returns, and integrals along range.
//
// Sonar frame: x along the centre beam, y to port, z up; positive bearing is to starboard, so a
// point at range r, bearing b, elevation e is (r cos e cos b, -r cos e sin b, r sin e).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "mapperd/map/beam_pyramid.hpp"
#include "mapperd/map/iwlo.hpp"
#include "mapperd/map/ping_motion.hpp"
#include "mapperd/map/radial.hpp"
#include "mapperd/common/vec.hpp"

namespace mapperd::map {

enum class Aggregation {
  occupied_first,  // occupied evidence beats free evidence inside one ping
  mean,            // the plain average of both kinds, as the published rule has it
};

// A view of a ping image: row-major, row 0 nearest, column 0 the most negative bearing.
struct PingImage {
  const float* intensity = nullptr;
  std::size_t rows = 0;
  std::size_t beams = 0;
  const double* bearings_rad = nullptr;  // strictly increasing, within +-90 degrees
  double range_resolution_m = 0.0;

  float at(std::size_t row, std::size_t beam) const { return intensity[row * beams + beam]; }
  double max_range_m() const { return static_cast<double>(rows) * range_resolution_m; }
};

struct FanSettings {
  double vertical_aperture_rad = 0.349065850398866;  // 20 degrees
  double min_range_m = 0.5;
  bool carve_no_return = false;
  Aggregation aggregation = Aggregation::occupied_first;
  // Log-odds that one ping's step may be off by in a voxel; 0: exact.
  double error_bound = 0.0;
  int threads = 1;  // the map does not depend on it
};

// Throws std::invalid_argument, naming the argument, for a ping that cannot be projected.
void check_ping(const PingImage& image, const FanSettings& settings);

// Beam edges in radians, beams + 1 of them: half way between neighbours in sine space, because
// the sonar spaces its beams uniformly in sine; the outermost are extrapolated.
std::vector<double> beam_edges(const double* bearings_rad, std::size_t beams);

// The part of the fan that a cube can lie in.
struct FanPart {
  std::size_t first_beam = 0;
  std::size_t last_beam = 0;
  double near_m = 0.0;
  double far_m = 0.0;
  bool cut_by_aperture = false;
  bool cut_by_sides = false;  // or by min_range
};

// A ping in the frame the map is aligned with: the sonar at the origin, the map's axes. Of a sonar
// that moves, this is the fan at transmission, and all but `verdict` and `reach_m` is about what is
// seen there (ping_motion.hpp).
class Fan {
 public:
  // map_R_sonar is the rotation of `map_T_sonar`, of a moving sonar that at transmission; its
  // translation plays no part.
  Fan(const PingImage& image, const FanSettings& settings, const IwloRule& rule,
      const Transform& map_T_sonar, const PingMotion& motion = {});

  std::size_t beams() const { return free_limit_m_.size(); }
  std::size_t rows() const { return row_count_; }
  double range_resolution_m() const { return resolution_; }
  double min_range_m() const { return min_range_; }
  double max_range_m() const { return max_range_; }
  // The ping says nothing of places farther away.
  double reach_m() const { return view_ ? view_->reach_m(max_range_) : max_range_; }
  // Null for a sonar at rest.
  const MovingView* view() const { return view_ ? &*view_ : nullptr; }
  double sin_half_aperture() const { return sin_half_; }
  double cos_half_aperture() const { return cos_half_; }

  // From the map's axes to the sonar's, and back.
  Vec3 to_sonar(const Vec3& v) const { return rotation_.rotate_back(v); }
  Vec3 to_map(const Vec3& v) const { return rotation_.rotate(v); }

  // Beam edges; the plane through each edge and the sonar's vertical axis has a normal that
  // points to larger bearings.
  const std::vector<double>& edges_rad() const { return edges_; }
  Vec3 normal_at(double bearing_rad) const;
  const Vec3& edge_normal(std::size_t edge) const { return edge_normals_[edge]; }

  // Planes through the sonar (normals inwards) that stand for the aperture's two cones between
  // two bearings: those of the cones' mean height.
  void aperture_planes(double low_rad, double high_rad, Vec3& upper, Vec3& lower) const;
  // Those that touch the cones straight above and below a point of the sonar's frame.
  void aperture_planes_at(const Vec3& in_sonar, Vec3& upper, Vec3& lower) const;

  // Beam j's w(I), row by row; kNoReturn in rows without one, or wholly nearer than min_range.
  static constexpr float kNoReturn = -1.0F;
  const float* weights(std::size_t j) const { return &weights_[j * row_count_]; }
  // Beam j is free from min_range up to here; 0: it says nothing of free space.
  double free_limit_m(std::size_t j) const { return free_limit_m_[j]; }
  double least_free_m(std::size_t first, std::size_t last) const {
    return least_free_m_.of(first, last);
  }
  double most_free_m(std::size_t first, std::size_t last) const {
    return most_free_m_.of(first, last);
  }

  // The same as functions of range: returns of beam j, and its free space.
  const RadialProfile& returns(std::size_t j) const { return returns_[j]; }
  const RadialProfile& free_space(std::size_t j) const { return free_space_[j]; }
  bool any_return(std::size_t first, std::size_t last, double near_m, double far_m) const {
    // A hair of slack swallows the rounding of the product.
    const double from = near_m * rows_per_m_ - kRowSlack;
    const double end = far_m * rows_per_m_ + (1.0 + kRowSlack);
    const auto rows = static_cast<std::ptrdiff_t>(row_count_);
    const auto first_row = std::max(static_cast<std::ptrdiff_t>(from), std::ptrdiff_t{0});
    const auto end_row = std::min(static_cast<std::ptrdiff_t>(end), rows);
    return first_row < end_row && return_rows_.any(first, last, static_cast<std::size_t>(first_row),
                                                   static_cast<std::size_t>(end_row));
  }
  // Beam j's returns in up to 64 rows from `row` to before `end`, a bit each.
  std::uint64_t returns_in_rows(std::size_t j, std::size_t row, std::size_t end) const {
    return return_rows_.rows_of(j, row, end);
  }

  // The beam that holds a bearing, given its sine; the outermost for bearings outside the fan.
  std::size_t beam_at_sine(double sine) const {
    double cell = (sine - edge_sines_.front()) * guesses_per_sine_;
    if (!(cell > 0)) cell = 0;  // straight above the sonar the sine is no number
    const auto most = static_cast<double>(beam_guess_.size() - 1);
    std::size_t beam = beam_guess_[static_cast<std::size_t>(std::min(cell, most))];
    while (beam + 1 < beams() && edge_sines_[beam + 1] <= sine) ++beam;
    while (beam > 0 && edge_sines_[beam] > sine) --beam;
    return beam;
  }

  // What a cube with the given centre (map axes, sonar as origin) and edge can hold:
  // `mostly_free` is free by more than half, `less_free` by less, and neither holds a return.
  enum class Content { nothing, less_free, undecided, mostly_free, all_free };
  struct Verdict {
    Content content = Content::nothing;
    FanPart where;  // set unless nothing
  };
  Verdict verdict(const Vec3& centre, double edge_m) const;
  // The same for a cube that a moving sonar sees so.
  Verdict verdict(const Seen& seen, const Widening& widening, double edge_m) const;

  // How far a cube reaches from its centre, along the directions that matter.
  struct Extent {
    double inward;    // towards the sonar
    double outward;   // away from it
    double sideways;  // in bearing, horizontally
    double forward;   // horizontally towards and away from the sonar's vertical axis
    double aperture;  // across the nearer of the aperture's cones
    double bend;      // by how much that cone departs from a plane inside the cube
    // The nearest and farthest slices of a voxel, this deep, hold less than 1 % of it each: returns
    // there alone do not make it occupied. 0 for larger cubes.
    double cap;
    double level;   // in any horizontal direction: the fan's sides are not square to the bearing
    double spread;  // of the bearing's sine
    double edge;    // of a voxel, where `cap` is known
    double warp;    // by how much what a moving sonar sees of the cube is bent
  };
  // Where a cube's centre lies, seen from the sonar.
  struct Place {
    double range;
    double horizontal;  // distance from the sonar's vertical axis
    double sine;        // of the bearing
    double inside_aperture;
    double inside_sides;
  };
  Extent extent_of(const Vec3& in_sonar, double edge_m, const Widening& widening = {}) const;
  static Extent ball(double radius, double horizontal);
  // One that holds for every cube of that edge in a cell of them, `cell` along an edge, around a
  // point at least five cells away from the sonar.
  Extent extent_in_cell(const Vec3& in_sonar, double edge_m, int cell,
                        const Widening& widening = {}) const;
  Place place_of(const Vec3& centre) const;
  // The plane at one of the fan's sides as a linear function: positive inside.
  Vec3 low_side() const { return edge_normals_.front(); }
  Vec3 high_side() const { return -1.0 * edge_normals_.back(); }
  // As above, for a cube whose place and extent are known, `centre` being where it is seen. `axes`
  // says how; null for a sonar at rest.
  Verdict verdict(const Vec3& centre, const Place& place, const Extent& extent,
                  const SeenAxes* axes = nullptr) const;

 private:
  Content free_between_beams(const Vec3& centre, const Extent& extent, const FanPart& where,
                             const SeenAxes* axes) const;
  static void widen(Extent& extent, const Widening& widening);
  void fill_weights(const PingImage& image, const IwloRule& rule);
  void fill_profiles();
  void add_returns(std::size_t j);
  void link_profiles(const std::vector<std::size_t>& ends);
  void index_sines();

  static double seen_edge(double edge_m, const Widening& widening);
  Extent extent_at_rest(const Vec3& in_sonar, double edge_m) const;
  Extent extent_in_cell_at_rest(const Vec3& in_sonar, double edge_m, int cell) const;

  static constexpr double kRowSlack = 1e-6;
  // Half of the part that makes a voxel occupied: it has two ends.
  static constexpr double kNegligiblePart = 0.01;

  std::size_t row_count_;
  double resolution_;
  double rows_per_m_;
  double min_range_;
  double max_range_;
  double sin_half_;
  double cos_half_;
  Transform rotation_;
  std::optional<MovingView> view_;
  std::vector<double> edges_;
  std::vector<Vec3> edge_normals_;  // map axes
  std::vector<double> edge_sines_;
  std::vector<std::uint32_t> beam_guess_;  // by sine, the beam at the cell's low end
  double guesses_per_sine_ = 0.0;
  std::vector<float> weights_;  // beam-major
  ReturnRows return_rows_;
  std::vector<double> free_limit_m_;  // free from min_range up to here; 0: says nothing
  RunExtreme<Smaller> least_free_m_;
  RunExtreme<Larger> most_free_m_;
  std::vector<RadialPiece> pieces_;  // of all beams, returns first, then free space
  std::vector<RadialProfile> returns_;
  std::vector<RadialProfile> free_space_;
};

}  // namespace mapperd::map
