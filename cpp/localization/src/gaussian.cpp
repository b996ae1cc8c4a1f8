#include "mapperd/localization/gaussian.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {
namespace {

constexpr double kTolerance = 1e-9;

Matrix3 symmetric(const Matrix3& covariance) {
  Matrix3 even = covariance;
  double largest = 0.0;
  for (const auto& row : covariance) {
    for (const double value : row) {
      if (!std::isfinite(value)) throw std::invalid_argument("the covariance must be finite");
      largest = std::max(largest, std::abs(value));
    }
  }
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (std::abs(covariance[i][j] - covariance[j][i]) > kTolerance * largest) {
        throw std::invalid_argument("the covariance must be symmetric");
      }
      even[i][j] = even[j][i] = 0.5 * (covariance[i][j] + covariance[j][i]);
    }
  }
  return even;
}

// One Jacobi rotation: makes a[p][q] zero; the columns of v turn with it.
void rotate(Matrix3& a, Matrix3& v, std::size_t p, std::size_t q) {
  if (a[p][q] == 0.0) return;
  const double angle = 0.5 * std::atan2(2.0 * a[p][q], a[q][q] - a[p][p]);
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  for (std::size_t k = 0; k < 3; ++k) {
    const double kp = a[k][p];
    a[k][p] = c * kp - s * a[k][q];
    a[k][q] = s * kp + c * a[k][q];
  }
  for (std::size_t k = 0; k < 3; ++k) {
    const double pk = a[p][k];
    a[p][k] = c * pk - s * a[q][k];
    a[q][k] = s * pk + c * a[q][k];
    const double vp = v[k][p];
    v[k][p] = c * vp - s * v[k][q];
    v[k][q] = s * vp + c * v[k][q];
  }
}

}  // namespace

Matrix3 square_root_of(const Matrix3& covariance) {
  Matrix3 a = symmetric(covariance);
  Matrix3 v{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  for (int sweep = 0; sweep < 16; ++sweep) {
    rotate(a, v, 0, 1);
    rotate(a, v, 0, 2);
    rotate(a, v, 1, 2);
  }
  const double largest = std::max({a[0][0], a[1][1], a[2][2]});
  for (std::size_t k = 0; k < 3; ++k) {
    if (a[k][k] < -kTolerance * std::max(largest, 0.0)) {
      throw std::invalid_argument("the covariance must be positive semi-definite");
    }
    const double root = std::sqrt(std::max(a[k][k], 0.0));
    for (std::size_t i = 0; i < 3; ++i) v[i][k] *= root;
  }
  return v;
}

void draw_about(const Pose2& mean, const Matrix3& root, const Stream& stream,
                Particles& particles) {
  NormalBlock normals;
  for (std::size_t start = 0; start < particles.size(); start += kBlock) {
    const std::size_t count = std::min(kBlock, particles.size() - start);
    draw_normals(stream, Purpose::kStart, start, count, normals);
    for (std::size_t i = 0; i < count; ++i) {
      double off[3];
      for (std::size_t k = 0; k < 3; ++k) {
        off[k] = root[k][0] * normals.number[0][i] + root[k][1] * normals.number[1][i] +
                 root[k][2] * normals.number[2][i];
      }
      particles.set(start + i, {mean.x + off[0], mean.y + off[1], wrapped(mean.yaw + off[2])});
    }
  }
}

}  // namespace mapperd::localization
