#include "oracle_motion.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace oracle {
namespace {

using mapperd::map::PingImage;
using mapperd::Transform;
using mapperd::Vec3;

// A Fibonacci lattice in the unit square.
constexpr int kLines = 4181;
constexpr int kGenerator = 2584;
constexpr int kPieces = 12;
constexpr double kShortest = 1e-6;  // of a line's length

Vec3 component_wise(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

// By an angle about an axis: the columns of the rotation's matrix (Rodrigues).
Vec3 rotated(const Vec3& axis, double angle, const Vec3& v) {
  const double c = std::cos(angle);
  return c * v + (std::sin(angle) * mapperd::cross(axis, v) + (1 - c) * dot(axis, v) * axis);
}

// Where a sample lies in the image; samples of the same place are of the same evidence.
struct Pixel {
  std::ptrdiff_t row = -1;  // -1: outside
  std::ptrdiff_t beam = -1;

  bool operator==(const Pixel& other) const { return row == other.row && beam == other.beam; }
};

class VoxelSampler {
 public:
  VoxelSampler(const PingImage& image, const Track& track, const Settings& settings)
      : image_(image), track_(track), settings_(settings), edges_(edges_of(image)) {
    for (std::size_t j = 0; j < image.beams; ++j) {
      std::size_t first = image.rows;
      for (std::size_t k = image.rows; k-- > 0;) {
        if (static_cast<double>(k + 1) * image.range_resolution_m > settings.fan.min_range_m &&
            image.at(k, j) > settings.iwlo.intensity_threshold) {
          first = k;
        }
      }
      first_row_.push_back(first);
    }
  }

  Parts sample(const Voxel& voxel) {
    const double s = settings_.resolution_m;
    const auto middle = [s](std::int64_t i) { return (static_cast<double>(i) + 0.5) * s; };
    const Vec3 centre{middle(voxel[0]), middle(voxel[1]), middle(voxel[2])};
    const Vec3 outward = centre - track_.position(0);
    const double x = std::abs(outward.x), y = std::abs(outward.y), z = std::abs(outward.z);
    const std::size_t axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
    Parts sum;
    for (int i = 0; i < kLines; ++i) {
      std::array<double, 3> across{}, along{};
      across[(axis + 1) % 3] = s * ((i + 0.5) / kLines - 0.5);
      across[(axis + 2) % 3] = s * ((i * kGenerator % kLines + 0.5) / kLines - 0.5);
      along[axis] = s / kPieces;
      const Vec3 step = component_wise(along);
      Vec3 from = centre + component_wise(across) - (0.5 * kPieces) * step;
      for (int k = 0; k < kPieces; ++k, from = from + step) {
        follow({from, pixel(from)}, {from + step, pixel(from + step)}, 1.0 / kPieces, sum);
      }
    }
    return {sum.occupied / kLines, sum.free / kLines, sum.weighted / kLines};
  }

 private:
  struct Sample {
    Vec3 at;
    Pixel pixel;
  };

  Pixel pixel(const Vec3& at) const {
    const Track::Heard heard = track_.heard(at);
    const double row = heard.range_m / image_.range_resolution_m;
    const bool inside = heard.range_m >= settings_.fan.min_range_m &&
                        row < static_cast<double>(image_.rows) &&
                        std::abs(heard.elevation_rad) <= settings_.fan.vertical_aperture_rad / 2 &&
                        heard.bearing_rad >= edges_.front() && heard.bearing_rad < edges_.back();
    if (!inside) return {};
    const auto beam = std::upper_bound(edges_.begin(), edges_.end(), heard.bearing_rad);
    return {static_cast<std::ptrdiff_t>(row), beam - edges_.begin() - 1};
  }

  void follow(const Sample& from, const Sample& to, double length, Parts& sum) const {
    if (from.pixel == to.pixel || length < kShortest) return add(from.pixel, length, sum);
    const Vec3 middle = 0.5 * (from.at + to.at);
    const Sample half{middle, pixel(middle)};
    follow(from, half, length / 2, sum);
    follow(half, to, length / 2, sum);
  }

  void add(const Pixel& pixel, double length, Parts& sum) const {
    if (pixel.row < 0) return;
    const auto row = static_cast<std::size_t>(pixel.row);
    const auto beam = static_cast<std::size_t>(pixel.beam);
    if (first_row_[beam] == image_.rows && !settings_.fan.carve_no_return) return;
    if (row < first_row_[beam]) sum.free += length;
    if (row < first_row_[beam] || !(image_.at(row, beam) > settings_.iwlo.intensity_threshold)) {
      return;
    }
    sum.occupied += length;
    sum.weighted += length * weight_of(image_.at(row, beam), settings_.iwlo);
  }

  const PingImage& image_;
  const Track& track_;
  const Settings& settings_;
  std::vector<double> edges_;
  std::vector<std::size_t> first_row_;
};

}  // namespace

Vec3 Track::position(double time_s) const {
  return pose_.translation + (time_s - motion_.valid_s) * motion_.linear_mps;
}

Transform Track::at(double time_s) const {
  const double since = time_s - motion_.valid_s;
  Transform pose = pose_;
  pose.translation = position(time_s);
  const double rate = norm(motion_.angular_radps);
  if (!(rate > 0)) return pose;
  const Vec3 axis = (1.0 / rate) * motion_.angular_radps;
  // Rows of map_R_sonar exp(w t): the old ones, turned the other way.
  for (Vec3& row : pose.rows) row = rotated(axis, -rate * since, row);
  return pose;
}

Track::Heard Track::heard(const Vec3& point) const {
  const double out = norm(point - position(0));
  double range = out;
  for (int i = 0; i < 30; ++i) {
    const double before = range;
    const double back = norm(point - position(2 * range / motion_.speed_of_sound_mps));
    range = 0.5 * (out + back);
    if (std::abs(range - before) < 1e-13 * range) break;
  }
  const Transform then = at(2 * range / motion_.speed_of_sound_mps);
  const Vec3 v = then.rotate_back(point - then.translation);
  return {range, std::atan2(-v.y, v.x), std::atan2(v.z, std::hypot(v.x, v.y))};
}

Vec3 Track::point(const Heard& heard) const {
  const Transform then = at(2 * heard.range_m / motion_.speed_of_sound_mps);
  const double flat = std::cos(heard.elevation_rad);
  const Vec3 ahead =
      then.rotate({flat * std::cos(heard.bearing_rad), -flat * std::sin(heard.bearing_rad),
                   std::sin(heard.elevation_rad)});
  double leg = heard.range_m;
  for (int i = 0; i < 60; ++i) {
    const Vec3 sent_leg = then.translation + leg * ahead - position(0);
    leg = 0.5 * (leg + 2 * heard.range_m - norm(sent_leg));
  }
  return then.translation + leg * ahead;
}

Parts parts_of_voxel(const PingImage& image, const Track& track, const Settings& settings,
                     const Voxel& voxel) {
  return VoxelSampler(image, track, settings).sample(voxel);
}

}  // namespace oracle
