#include "mapperd/localization/estimate.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {
namespace {

struct Means {
  double mass = 0.0;
  double squares = 0.0;  // sum of the squared weights of sum 1
  Pose2 pose;
  double resultant = 0.0;  // length of the mean unit vector of the headings
};

Means means_of(const Particles& p, const std::vector<double>& w,
               const std::vector<std::size_t>& chosen) {
  Means m;
  double x = 0.0, y = 0.0, cosine = 0.0, sine = 0.0;
  const double x0 = p.x[chosen.front()];  // sums stay small far from the origin
  const double y0 = p.y[chosen.front()];
  for (const std::size_t i : chosen) {
    const SineCosine heading = fast_sine_cosine(p.yaw[i]);
    m.mass += w[i];
    m.squares += w[i] * w[i];
    x += w[i] * (p.x[i] - x0);
    y += w[i] * (p.y[i] - y0);
    cosine += w[i] * heading.cosine;
    sine += w[i] * heading.sine;
  }
  m.squares /= m.mass * m.mass;
  m.resultant = std::min(1.0, std::hypot(cosine, sine) / m.mass);
  const bool known = m.resultant >= 1e-15;
  m.pose = {x0 + x / m.mass, y0 + y / m.mass, known ? std::atan2(sine, cosine) : 0.0};
  return m;
}

struct Spreads {
  double xx = 0.0, xy = 0.0, yy = 0.0, xa = 0.0, ya = 0.0;
};

Spreads spreads_of(const Particles& p, const std::vector<double>& w,
                   const std::vector<std::size_t>& chosen, const Means& m) {
  Spreads s;
  for (const std::size_t i : chosen) {
    const double dx = p.x[i] - m.pose.x;
    const double dy = p.y[i] - m.pose.y;
    const double da = wrapped(p.yaw[i] - m.pose.yaw);
    const double weight = w[i] / m.mass;
    s.xx += weight * dx * dx;
    s.xy += weight * dx * dy;
    s.yy += weight * dy * dy;
    s.xa += weight * dx * da;
    s.ya += weight * dy * da;
  }
  return s;
}

// How much of the cross terms a covariance bears: c^T A^-1 c must not exceed the heading's
// variance.
double cross_share(const Matrix3& c, double xa, double ya) {
  const double determinant = c[0][0] * c[1][1] - c[0][1] * c[0][1];
  if (!(determinant > 0.0)) return 0.0;
  const double explained =
      (c[1][1] * xa * xa - 2.0 * c[0][1] * xa * ya + c[0][0] * ya * ya) / determinant;
  return explained <= c[2][2] ? 1.0 : std::sqrt(c[2][2] / explained) * (1.0 - 1e-12);
}

Matrix3 covariance_of(const Means& m, const Spreads& s, bool spread, bool heading) {
  const double unbiased = spread ? 1.0 / (1.0 - m.squares) : 1.0;
  const double turn =
      heading ? -2.0 * std::log(m.resultant) + 0.0 : std::numeric_limits<double>::infinity();
  Matrix3 c{};
  c[0][0] = std::max(kMinVariance, s.xx * unbiased);
  c[1][1] = std::max(kMinVariance, s.yy * unbiased);
  c[2][2] = std::max(kMinVariance, turn);
  const double most = std::sqrt(c[0][0]) * std::sqrt(c[1][1]);
  c[0][1] = c[1][0] = std::clamp(s.xy * unbiased, -most, most);
  if (!heading) return c;
  const double share = cross_share(c, s.xa, s.ya);
  c[0][2] = c[2][0] = share * s.xa;
  c[1][2] = c[2][1] = share * s.ya;
  return c;
}

}  // namespace

Estimate estimate_of(const Particles& particles, const std::vector<double>& weight,
                     const std::vector<std::size_t>& chosen) {
  Estimate e;
  e.particles = chosen.size();
  if (chosen.empty()) return e;
  const Means m = means_of(particles, weight, chosen);
  if (!(m.mass > 0.0)) return e;
  e.mass = m.mass;
  e.mean = m.pose;
  e.heading_known = m.resultant >= 1e-15;
  e.spread_known = m.squares < 1.0 - 1e-12;
  e.covariance =
      covariance_of(m, spreads_of(particles, weight, chosen, m), e.spread_known, e.heading_known);
  return e;
}

Estimate estimate_of(const Particles& particles, const std::vector<double>& weight) {
  std::vector<std::size_t> all(particles.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  return estimate_of(particles, weight, all);
}

}  // namespace mapperd::localization
