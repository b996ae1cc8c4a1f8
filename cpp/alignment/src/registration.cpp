#include "mapperd/alignment/registration.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <utility>

namespace mapperd::alignment {
namespace {

constexpr std::int32_t kUnknownCell = -2;
constexpr std::int32_t kFreeCell = -1;
constexpr double kUnitM = kMaxDistanceM / 255.0;
constexpr std::size_t kSearchPoints = 500;
constexpr std::size_t kRefinePoints = 2500;
constexpr double kSearchScaleM = 0.4;
constexpr double kFitScaleM = 0.2;
constexpr double kLeastShare = 0.05;  // of the points: matches on fewer count less
constexpr std::array<double, 3> kFieldScalesM{1.0, 0.5, 0.3};
constexpr int kFieldSteps = 8;
constexpr int kMatchSteps = 20;
constexpr double kNeighbourhoodM = 0.5;
constexpr double kMatchReachM = 0.8;
constexpr double kVoxelNoise = 0.35;  // standard deviation of a voxel's place in edges
constexpr double kKernel = 3.0;       // Geman-McClure, in standard deviations
constexpr double kEdgeVoxels = 1.2;   // further into unobserved space a point matches nothing
constexpr double kColumnM = 2.0;      // edge of the clusters of correlated residuals
constexpr double kStopM = 1e-4;
constexpr double kStopRad = 1e-5;

struct Planar {
  double c, s, x, y;
  explicit Planar(const Pose2& p) : c(std::cos(p.yaw)), s(std::sin(p.yaw)), x(p.x), y(p.y) {}
  Vec3 apply(const Vec3& p) const { return {c * p.x - s * p.y + x, s * p.x + c * p.y + y, p.z}; }
  Vec3 back(const Vec3& p) const {
    const double dx = p.x - x;
    const double dy = p.y - y;
    return {c * dx + s * dy, -s * dx + c * dy, p.z};
  }
  Vec3 turn(const Vec3& p) const { return {c * p.x - s * p.y, s * p.x + c * p.y, p.z}; }
};

// Indices of about `count` of `size` elements, evenly spread.
template <typename Visit>
std::size_t for_evenly(std::size_t size, std::size_t count, const Visit& visit) {
  const std::size_t taken = std::min(size, count);
  for (std::size_t k = 0; k < taken; ++k) visit(k * size / taken);
  return taken;
}

using Vector3 = std::array<double, 3>;

// Normal equations of a least-squares step in x, y and yaw.
struct Normal {
  Matrix3 h{};
  Vector3 g{};

  void add(const Vector3& jacobian, double weight, double residual) {
    for (std::size_t i = 0; i < 3; ++i) {
      g[i] += weight * jacobian[i] * residual;
      for (std::size_t j = 0; j < 3; ++j) h[i][j] += weight * jacobian[i] * jacobian[j];
    }
  }
};

Matrix3 inverse(const Matrix3& m) {
  const double a = m[1][1] * m[2][2] - m[1][2] * m[2][1];
  const double b = m[1][2] * m[2][0] - m[1][0] * m[2][2];
  const double c = m[1][0] * m[2][1] - m[1][1] * m[2][0];
  const double determinant = m[0][0] * a + m[0][1] * b + m[0][2] * c;
  const double k = 1.0 / determinant;
  return {{{a * k, (m[0][2] * m[2][1] - m[0][1] * m[2][2]) * k,
            (m[0][1] * m[1][2] - m[0][2] * m[1][1]) * k},
           {b * k, (m[0][0] * m[2][2] - m[0][2] * m[2][0]) * k,
            (m[0][2] * m[1][0] - m[0][0] * m[1][2]) * k},
           {c * k, (m[0][1] * m[2][0] - m[0][0] * m[2][1]) * k,
            (m[0][0] * m[1][1] - m[0][1] * m[1][0]) * k}}};
}

Matrix3 product(const Matrix3& a, const Matrix3& b) {
  Matrix3 out{};
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
  return out;
}

// Adds a ridge, relative to the matrix, that keeps open directions where they are.
Matrix3 with_ridge(Matrix3 h, double share) {
  const double across = std::max({h[0][0], h[1][1], 1e-9});
  h[0][0] += share * across;
  h[1][1] += share * across;
  h[2][2] += share * std::max(h[2][2], 1e-9);
  return h;
}

Vector3 solve(const Normal& normal, double ridge) {
  const Matrix3 inverted = inverse(with_ridge(normal.h, ridge));
  Vector3 step{};
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) step[i] += inverted[i][j] * normal.g[j];
  return step;
}

bool is_small(const Vector3& step) {
  return std::abs(step[0]) < kStopM && std::abs(step[1]) < kStopM && std::abs(step[2]) < kStopRad;
}

void take(Pose2& pose, const Vector3& step) {
  pose.x += step[0];
  pose.y += step[1];
  pose.yaw += step[2];
}

// Largest integer that is not above a number; several times as fast as `std::floor`.
std::int64_t floor_of(double number) {
  const auto whole = static_cast<std::int64_t>(number);
  return whole - static_cast<std::int64_t>(static_cast<double>(whole) > number);
}

double geman_mcclure(double squared, double scale) {
  const double k = scale * scale;
  const double w = k / (k + squared);
  return w * w;
}

}  // namespace

// ---------------------------------------------------------------------------------------- Submap

Submap::Submap(const std::vector<Vec3>& occupied, const std::vector<Vec3>& free,
               double resolution_m, const std::vector<double>& weights)
    : resolution_m_(resolution_m), centres_m_(occupied) {
  if (!(resolution_m > 0) || !std::isfinite(resolution_m)) {
    throw std::invalid_argument("resolution_m must be a positive number");
  }
  if (occupied.empty()) throw std::invalid_argument("a submap needs an occupied voxel");
  if (weights.size() != occupied.size()) {
    throw std::invalid_argument("weights must have one entry for each occupied voxel");
  }
  for (const double weight : weights) {
    if (!(weight > 0) || !std::isfinite(weight)) {
      throw std::invalid_argument("a weight must be a positive number");
    }
  }
  mark(occupied, free);
  measure_distances();
  gather_distributions(weights);
}

std::array<std::int64_t, 3> Submap::voxel_of(const Vec3& p) const {
  std::array<std::int64_t, 3> voxel{};
  for (std::size_t k = 0; k < 3; ++k) voxel[k] = floor_of(p[k] / resolution_m_) - first_[k];
  return voxel;
}

bool Submap::contains(const std::array<std::int64_t, 3>& v) const {
  return v[0] >= 0 && v[1] >= 0 && v[2] >= 0 && v[0] < size_[0] && v[1] < size_[1] &&
         v[2] < size_[2];
}

std::size_t Submap::place(const std::array<std::int64_t, 3>& v) const {
  return static_cast<std::size_t>((v[2] * size_[1] + v[1]) * size_[0] + v[0]);
}

void Submap::mark(const std::vector<Vec3>& occupied, const std::vector<Vec3>& free) {
  std::array<std::int64_t, 3> low{}, high{};
  low.fill(std::numeric_limits<std::int64_t>::max());
  high.fill(std::numeric_limits<std::int64_t>::min());
  constexpr double kFurthest = 1e9;  // voxels
  for (const auto* points : {&occupied, &free}) {
    for (const Vec3& p : *points) {
      for (std::size_t k = 0; k < 3; ++k) {
        const double at = std::floor(p[k] / resolution_m_);
        if (!(std::abs(at) < kFurthest)) throw std::invalid_argument("a centre is out of range");
        low[k] = std::min(low[k], static_cast<std::int64_t>(at));
        high[k] = std::max(high[k], static_cast<std::int64_t>(at));
      }
    }
  }
  const auto margin = static_cast<std::int64_t>(std::ceil(kMaxDistanceM / resolution_m_)) + 1;
  double cells = 1;
  for (std::size_t k = 0; k < 3; ++k) {
    first_[k] = low[k] - margin;
    size_[k] = high[k] - low[k] + 1 + 2 * margin;
    cells *= static_cast<double>(size_[k]);
  }
  if (cells > static_cast<double>(kMaxCells)) {
    throw std::invalid_argument("the box of a submap has too many voxels");
  }
  cells_.assign(static_cast<std::size_t>(cells), kUnknownCell);
  for (const Vec3& p : free) cells_[place(voxel_of(p))] = kFreeCell;
  for (std::size_t i = 0; i < occupied.size(); ++i) {
    cells_[place(voxel_of(occupied[i]))] = static_cast<std::int32_t>(i);
  }
}

// Squared distances in voxels, one axis after the other, each over the reach only.
void Submap::measure_distances() {
  const int reach = static_cast<int>(std::ceil(kMaxDistanceM / resolution_m_));
  const int far = reach * reach + 1;
  std::vector<std::uint16_t> squared(cells_.size());
  for (std::size_t i = 0; i < cells_.size(); ++i) {
    squared[i] = cells_[i] >= 0 ? std::uint16_t{0} : static_cast<std::uint16_t>(far);
  }
  std::vector<std::uint16_t> line, out;
  const std::array<std::int64_t, 3> stride{1, size_[0], size_[0] * size_[1]};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::size_t b = axis == 0 ? 1 : 0;
    const std::size_t c = axis == 2 ? 1 : 2;
    const auto length = static_cast<std::size_t>(size_[axis]);
    line.assign(length + 2 * static_cast<std::size_t>(reach), static_cast<std::uint16_t>(far));
    out.resize(length);
    for (std::int64_t v = 0; v < size_[c]; ++v) {
      for (std::int64_t u = 0; u < size_[b]; ++u) {
        std::uint16_t* at = squared.data() + v * stride[c] + u * stride[b];
        bool any = false;
        for (std::size_t i = 0; i < length; ++i) {
          const auto value = at[static_cast<std::int64_t>(i) * stride[axis]];
          line[i + static_cast<std::size_t>(reach)] = value;
          any = any || value < far;
        }
        if (!any) continue;
        std::fill(out.begin(), out.end(), static_cast<std::uint16_t>(far));
        for (int d = -reach; d <= reach; ++d) {
          const auto more = static_cast<std::uint16_t>(d * d);
          const std::uint16_t* from = line.data() + reach + d;
          for (std::size_t i = 0; i < length; ++i) {
            out[i] = std::min(out[i], static_cast<std::uint16_t>(from[i] + more));
          }
        }
        for (std::size_t i = 0; i < length; ++i) {
          at[static_cast<std::int64_t>(i) * stride[axis]] = out[i];
        }
      }
    }
  }
  std::vector<std::uint8_t> unit_of(static_cast<std::size_t>(far) + 1);
  for (std::size_t s = 0; s < unit_of.size(); ++s) {
    const double units = std::sqrt(static_cast<double>(s)) * resolution_m_ / kUnitM;
    unit_of[s] = static_cast<std::uint8_t>(std::min(255.0, units + 0.5));
  }
  distances_.resize(squared.size());
  for (std::size_t i = 0; i < squared.size(); ++i) {
    distances_[i] = unit_of[std::min<std::size_t>(squared[i], unit_of.size() - 1)];
  }
}

void Submap::gather_distributions(const std::vector<double>& weights) {
  const auto reach = static_cast<std::int64_t>(kNeighbourhoodM / resolution_m_);
  const double noise_m2 = kVoxelNoise * kVoxelNoise * resolution_m_ * resolution_m_;
  distributions_.resize(centres_m_.size());
  for (std::size_t i = 0; i < centres_m_.size(); ++i) {
    const auto at = voxel_of(centres_m_[i]);
    Vec3 sum;
    std::array<double, 6> square{};
    double total = 0;
    for (std::int64_t dz = -reach; dz <= reach; ++dz) {
      for (std::int64_t dy = -reach; dy <= reach; ++dy) {
        for (std::int64_t dx = -reach; dx <= reach; ++dx) {
          const std::int32_t j = cells_[place({at[0] + dx, at[1] + dy, at[2] + dz})];
          if (j < 0) continue;
          const Vec3 d = centres_m_[static_cast<std::size_t>(j)] - centres_m_[i];
          if (dot(d, d) > kNeighbourhoodM * kNeighbourhoodM) continue;
          const double w = weights[static_cast<std::size_t>(j)];
          sum = sum + w * d;
          square[0] += w * d.x * d.x;
          square[1] += w * d.x * d.y;
          square[2] += w * d.x * d.z;
          square[3] += w * d.y * d.y;
          square[4] += w * d.y * d.z;
          square[5] += w * d.z * d.z;
          total += w;
        }
      }
    }
    const Vec3 mean = (1.0 / total) * sum;
    distributions_[i].mean_m = centres_m_[i] + mean;
    distributions_[i].covariance_m2 = {square[0] / total - mean.x * mean.x + noise_m2,
                                       square[1] / total - mean.x * mean.y,
                                       square[2] / total - mean.x * mean.z,
                                       square[3] / total - mean.y * mean.y + noise_m2,
                                       square[4] / total - mean.y * mean.z,
                                       square[5] / total - mean.z * mean.z + noise_m2};
  }
}

VoxelView Submap::voxel_at(const Vec3& p) const {
  const auto voxel = voxel_of(p);
  if (!contains(voxel)) return {kMaxDistanceM, false};
  const std::size_t at = place(voxel);
  return {distances_[at] * kUnitM, cells_[at] == kFreeCell};
}

double Submap::distance_m(const Vec3& p, Vec3& gradient) const {
  gradient = {};
  std::array<std::int64_t, 3> base{};
  Vec3 part;
  for (std::size_t k = 0; k < 3; ++k) {
    const double at = p[k] / resolution_m_ - 0.5;
    const std::int64_t whole = floor_of(at);
    base[k] = whole - first_[k];
    part[k] = at - static_cast<double>(whole);
    if (base[k] < 0 || base[k] + 1 >= size_[k]) return kMaxDistanceM;
  }
  std::array<double, 8> corner{};
  const std::uint8_t* first = distances_.data() + place(base);
  const std::int64_t line = size_[0], layer = size_[0] * size_[1];
  for (std::size_t n = 0; n < 8; ++n) {
    const auto dx = static_cast<std::int64_t>(n & 1);
    const auto dy = static_cast<std::int64_t>((n >> 1) & 1);
    const auto dz = static_cast<std::int64_t>(n >> 2);
    corner[n] = first[dx + dy * line + dz * layer];
  }
  const auto mix = [](double a, double b, double t) { return a + t * (b - a); };
  const auto plane = [&](std::size_t n) {
    return mix(mix(corner[n], corner[n + 1], part.x), mix(corner[n + 2], corner[n + 3], part.x),
               part.y);
  };
  const auto slope_x = [&](std::size_t n) {
    return mix(corner[n + 1] - corner[n], corner[n + 3] - corner[n + 2], part.y);
  };
  const auto slope_y = [&](std::size_t n) {
    return mix(corner[n + 2] - corner[n], corner[n + 3] - corner[n + 1], part.x);
  };
  const double units = mix(plane(0), plane(4), part.z);
  if (units > 254.0) return kMaxDistanceM;
  const double k = kUnitM / resolution_m_;
  gradient = {k * mix(slope_x(0), slope_x(4), part.z), k * mix(slope_y(0), slope_y(4), part.z),
              k * (plane(4) - plane(0))};
  return units * kUnitM;
}

bool Submap::was_observed(const Vec3& p, double margin_m) const {
  const auto voxel = voxel_of(p);
  if (!contains(voxel)) return false;
  const std::size_t at = place(voxel);
  return distances_[at] * kUnitM <= margin_m || cells_[at] != kUnknownCell;
}

std::int32_t Submap::nearest(const Vec3& p, double reach_m) const {
  const auto at = voxel_of(p);
  if (!contains(at)) return -1;
  const double rough_m = distances_[place(at)] * kUnitM;  // from the voxel's centre
  if (rough_m > reach_m + resolution_m_) return -1;
  Vec3 centre, off;  // of the voxel, and from the point
  for (std::size_t k = 0; k < 3; ++k) {
    centre[k] = (static_cast<double>(at[k] + first_[k]) + 0.5) * resolution_m_;
    off[k] = centre[k] - p[k];
  }
  const double bound_m = rough_m + kUnitM + norm(off);
  double least = std::min(reach_m * reach_m, bound_m * bound_m);
  const auto reach = static_cast<std::int64_t>(std::ceil(rough_m / resolution_m_ + 0.9));
  const auto away2 = [&](std::size_t axis, std::int64_t voxel) {
    const double away_m = off[axis] + static_cast<double>(voxel - at[axis]) * resolution_m_;
    return away_m * away_m;
  };
  std::int32_t best = -1;
  const std::int64_t first_x = std::max<std::int64_t>(at[0] - reach, 0);
  const std::int64_t last_x = std::min(at[0] + reach, size_[0] - 1);
  for (std::int64_t z = std::max<std::int64_t>(at[2] - reach, 0);
       z <= std::min(at[2] + reach, size_[2] - 1); ++z) {
    const double of_layer = away2(2, z);
    if (of_layer > least) continue;
    for (std::int64_t y = std::max<std::int64_t>(at[1] - reach, 0);
         y <= std::min(at[1] + reach, size_[1] - 1); ++y) {
      if (of_layer + away2(1, y) > least) continue;
      const std::int32_t* row = cells_.data() + place({0, y, z});
      for (std::int64_t x = first_x; x <= last_x; ++x) {
        const std::int32_t j = row[x];
        if (j < 0) continue;
        const Vec3 d = centres_m_[static_cast<std::size_t>(j)] - p;
        const double squared = dot(d, d);
        if (squared < least) {
          least = squared;
          best = j;
        }
      }
    }
  }
  return best;
}

// ---------------------------------------------------------------------------------- Comparison

namespace {

// Sums over one submap's points in the other: matched weight, and weight in free space.
template <typename Move>
std::size_t tally(const Submap& field, const Submap& points, const Move& move, double scale_m,
                  std::size_t count, SubmapAgreement& sum) {
  const auto& all = points.distributions();
  return for_evenly(all.size(), count, [&](std::size_t i) {
    const Vec3 p = move(all[i].mean_m);
    const auto [d, is_free] = field.voxel_at(p);
    if (d >= kMaxDistanceM - kUnitM) {
      if (is_free) sum.contradicted += 1.0;
      return;
    }
    const double match = geman_mcclure(d * d, 1.5 * scale_m);
    sum.matched += match;
    if (is_free) sum.contradicted += 1.0 - match;
  });
}

}  // namespace

Candidate compare_submaps(const Submap& target, const Submap& source, const Pose2& pose,
                          double scale_m, std::size_t points) {
  const Planar target_T_source(pose);
  SubmapAgreement sum;
  std::size_t taken = tally(
      target, source, [&](const Vec3& p) { return target_T_source.apply(p); }, scale_m, points,
      sum);
  taken += tally(
      source, target, [&](const Vec3& p) { return target_T_source.back(p); }, scale_m, points, sum);
  const double k = 1.0 / static_cast<double>(taken);
  const SubmapAgreement shares{k * sum.matched, k * sum.contradicted};
  return {pose, shares, shares.matched / (shares.matched + shares.contradicted + kLeastShare)};
}

std::vector<Candidate> search_poses(const Submap& target, const Submap& source,
                                    const SearchWindow& window, std::size_t count) {
  const auto steps = [](double half, double step) {
    const double number = std::ceil(half / step - 1e-9);
    if (!(number >= 0 && number < 1e4)) {
      throw std::invalid_argument("the window of a search must be finite and its steps positive");
    }
    return static_cast<int>(number);
  };
  const int nx = steps(window.half_x_m, window.step_m);
  const int ny = steps(window.half_y_m, window.step_m);
  const int nw = steps(window.half_yaw, window.step_yaw);
  const std::size_t sx = static_cast<std::size_t>(2 * nx + 1);
  const std::size_t sy = static_cast<std::size_t>(2 * ny + 1);
  const std::size_t sw = static_cast<std::size_t>(2 * nw + 1);
  if (sx * sy * sw > 1'000'000) {
    throw std::invalid_argument("the window of a search has over a million poses");
  }
  std::vector<Candidate> all(sx * sy * sw);
  const auto at = [&](std::size_t w, std::size_t y, std::size_t x) -> Candidate& {
    return all[(w * sy + y) * sx + x];
  };
  for (std::size_t w = 0; w < sw; ++w) {
    for (std::size_t y = 0; y < sy; ++y) {
      for (std::size_t x = 0; x < sx; ++x) {
        const Pose2 pose{window.centre.x + (static_cast<double>(x) - nx) * window.step_m,
                         window.centre.y + (static_cast<double>(y) - ny) * window.step_m,
                         window.centre.yaw + (static_cast<double>(w) - nw) * window.step_yaw};
        at(w, y, x) = compare_submaps(target, source, pose, kSearchScaleM, kSearchPoints);
      }
    }
  }
  std::vector<std::size_t> peaks;
  for (std::size_t w = 0; w < sw; ++w) {
    for (std::size_t y = 0; y < sy; ++y) {
      for (std::size_t x = 0; x < sx; ++x) {
        const double score = at(w, y, x).score;
        bool is_peak = score > 0;
        for (std::size_t dw = w > 0 ? w - 1 : 0; is_peak && dw <= std::min(w + 1, sw - 1); ++dw) {
          for (std::size_t dy = y > 0 ? y - 1 : 0; is_peak && dy <= std::min(y + 1, sy - 1); ++dy) {
            for (std::size_t dx = x > 0 ? x - 1 : 0; dx <= std::min(x + 1, sx - 1); ++dx) {
              is_peak = is_peak && at(dw, dy, dx).score <= score;
            }
          }
        }
        if (is_peak) peaks.push_back((w * sy + y) * sx + x);
      }
    }
  }
  std::stable_sort(peaks.begin(), peaks.end(),
                   [&](std::size_t a, std::size_t b) { return all[a].score > all[b].score; });
  std::vector<Candidate> best;
  for (std::size_t i : peaks) {
    if (best.size() == count) break;
    best.push_back(all[i]);
  }
  return best;
}

// -------------------------------------------------------------------------------- Registration

namespace {

// Derivative of a moved point by x, y and yaw of the pose.
struct Derivative {
  double turn_x, turn_y;  // of yaw
};

Derivative derivative(const Planar& pose, const Vec3& moved) {
  return {-(moved.y - pose.y), moved.x - pose.x};
}

void refine_on_distances(const Submap& target, const Submap& source, Pose2& pose) {
  const double margin_m = kEdgeVoxels * target.resolution_m();
  for (const double scale_m : kFieldScalesM) {
    for (int step = 0; step < kFieldSteps; ++step) {
      const Planar t(pose);
      Normal normal;
      for_evenly(source.distributions().size(), kRefinePoints, [&](std::size_t i) {
        const Vec3 q = t.apply(source.distributions()[i].mean_m);
        Vec3 slope;
        const double d = target.distance_m(q, slope);
        if (d >= kMaxDistanceM || !target.was_observed(q, margin_m)) return;
        const auto turn = derivative(t, q);
        const Vector3 jacobian{slope.x, slope.y, slope.x * turn.turn_x + slope.y * turn.turn_y};
        normal.add(jacobian, geman_mcclure(d * d, scale_m), -d);
      });
      for_evenly(target.distributions().size(), kRefinePoints, [&](std::size_t i) {
        const Vec3& q = target.distributions()[i].mean_m;
        Vec3 slope;
        const Vec3 p = t.back(q);
        const double d = source.distance_m(p, slope);
        if (d >= kMaxDistanceM || !source.was_observed(p, margin_m)) return;
        // A step of the pose moves the point the other way in the source's frame.
        const Vec3 n = t.turn(slope);
        const auto turn = derivative(t, q);
        const Vector3 jacobian{-n.x, -n.y, -(n.x * turn.turn_x + n.y * turn.turn_y)};
        normal.add(jacobian, geman_mcclure(d * d, scale_m), -d);
      });
      const Vector3 move = solve(normal, 1e-3);
      take(pose, move);
      if (is_small(move)) break;
    }
  }
}

// Inverse of a symmetric 3 x 3 matrix (xx, xy, xz, yy, yz, zz).
std::array<double, 6> inverted(const std::array<double, 6>& m) {
  const double a = m[3] * m[5] - m[4] * m[4];
  const double b = m[2] * m[4] - m[1] * m[5];
  const double c = m[1] * m[4] - m[2] * m[3];
  const double k = 1.0 / (m[0] * a + m[1] * b + m[2] * c);
  return {a * k,
          b * k,
          c * k,
          (m[0] * m[5] - m[2] * m[2]) * k,
          (m[1] * m[2] - m[0] * m[4]) * k,
          (m[0] * m[3] - m[1] * m[1]) * k};
}

std::array<double, 6> turned(const Planar& t, const std::array<double, 6>& m) {
  const double xx = t.c * t.c * m[0] - 2 * t.c * t.s * m[1] + t.s * t.s * m[3];
  const double yy = t.s * t.s * m[0] + 2 * t.c * t.s * m[1] + t.c * t.c * m[3];
  const double xy = t.c * t.s * (m[0] - m[3]) + (t.c * t.c - t.s * t.s) * m[1];
  return {xx, xy, t.c * m[2] - t.s * m[4], yy, t.s * m[2] + t.c * m[4], m[5]};
}

struct MatchSums {
  Normal normal;
  std::map<std::pair<int, int>, Vector3> gradients;  // of each column of the target's frame
  std::size_t pairs = 0;

  void add(const Planar& t, const Distribution& in_target, const Distribution& in_source) {
    const Vec3 q = t.apply(in_source.mean_m);
    const Vec3 e = in_target.mean_m - q;
    auto sum = turned(t, in_source.covariance_m2);
    for (std::size_t k = 0; k < 6; ++k) sum[k] += in_target.covariance_m2[k];
    const auto m = inverted(sum);
    const Vec3 me{m[0] * e.x + m[1] * e.y + m[2] * e.z, m[1] * e.x + m[3] * e.y + m[4] * e.z,
                  m[2] * e.x + m[4] * e.y + m[5] * e.z};
    const double w = geman_mcclure(dot(e, me), kKernel);
    const auto turn = derivative(t, q);
    // Columns of the Jacobian: (1, 0, 0), (0, 1, 0), (turn_x, turn_y, 0).
    const Vector3 g{w * me.x, w * me.y, w * (turn.turn_x * me.x + turn.turn_y * me.y)};
    const Vec3 mt{m[0] * turn.turn_x + m[1] * turn.turn_y, m[1] * turn.turn_x + m[3] * turn.turn_y,
                  0};
    auto& h = normal.h;
    h[0][0] += w * m[0];
    h[0][1] += w * m[1];
    h[0][2] += w * mt.x;
    h[1][1] += w * m[3];
    h[1][2] += w * mt.y;
    h[2][2] += w * (turn.turn_x * mt.x + turn.turn_y * mt.y);
    h[1][0] = h[0][1];
    h[2][0] = h[0][2];
    h[2][1] = h[1][2];
    auto& cluster = gradients[{static_cast<int>(std::floor(q.x / kColumnM)),
                               static_cast<int>(std::floor(q.y / kColumnM))}];
    for (std::size_t i = 0; i < 3; ++i) {
      normal.g[i] += g[i];
      cluster[i] += g[i];
    }
    ++pairs;
  }
};

MatchSums match(const Submap& target, const Submap& source, const Pose2& pose) {
  const Planar t(pose);
  MatchSums sums;
  const auto& of_target = target.distributions();
  const auto& of_source = source.distributions();
  const double margin_m = kEdgeVoxels * target.resolution_m();
  for_evenly(of_source.size(), kRefinePoints, [&](std::size_t i) {
    const Vec3 q = t.apply(of_source[i].mean_m);
    if (!target.was_observed(q, margin_m)) return;
    const auto j = target.nearest(q, kMatchReachM);
    if (j >= 0) sums.add(t, of_target[static_cast<std::size_t>(j)], of_source[i]);
  });
  for_evenly(of_target.size(), kRefinePoints, [&](std::size_t i) {
    const Vec3 p = t.back(of_target[i].mean_m);
    if (!source.was_observed(p, margin_m)) return;
    const auto j = source.nearest(p, kMatchReachM);
    if (j >= 0) sums.add(t, of_target[i], of_source[static_cast<std::size_t>(j)]);
  });
  return sums;
}

// Inverse of H^-1 (sum of g g^T) H^-1 over the clusters, each with a ridge.
Matrix3 information_of(const MatchSums& sums) {
  Matrix3 spread{};
  for (const auto& cluster : sums.gradients) {
    const Vector3& g = cluster.second;
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = 0; j < 3; ++j) spread[i][j] += g[i] * g[j];
  }
  const auto clusters = static_cast<double>(sums.gradients.size());
  const double small = clusters > 3 ? clusters / (clusters - 3) : 10.0;  // few clusters know less
  for (auto& row : spread)
    for (double& value : row) value *= small;
  const Matrix3& h = sums.normal.h;
  Matrix3 information = product(product(h, inverse(with_ridge(spread, 1e-3))), h);
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      information[i][j] = information[j][i] = 0.5 * (information[i][j] + information[j][i]);
    }
  }
  return information;
}

}  // namespace

Registration register_submaps(const Submap& target, const Submap& source, const Pose2& start) {
  Registration result;
  result.pose = start;
  refine_on_distances(target, source, result.pose);
  MatchSums sums;
  for (int step = 0; step < kMatchSteps; ++step) {
    sums = match(target, source, result.pose);
    const Vector3 move = solve(sums.normal, 1e-3);
    take(result.pose, move);
    result.converged = is_small({move[0] / 10, move[1] / 10, move[2] / 10});
    if (result.converged) break;
  }
  sums = match(target, source, result.pose);
  result.curvature = sums.normal.h;
  if (sums.pairs > 0) result.information = information_of(sums);
  result.pose.yaw = std::remainder(result.pose.yaw, 2 * std::acos(-1.0));
  result.fit = compare_submaps(target, source, result.pose, kFitScaleM, kRefinePoints);
  return result;
}

}  // namespace mapperd::alignment
