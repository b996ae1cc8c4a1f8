#include "mapperd/localization/motion.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "mapperd/common/fast_math.hpp"

namespace mapperd::localization {
namespace {

constexpr double kNoDirectionM = 0.01;
constexpr double kStationarySigma = 0.02;  // m, m, rad

double squared(double value) { return value * value; }

double folded(double angle) {
  return std::min(std::abs(wrapped(angle)), std::abs(wrapped(angle - kPi)));
}

MotionDraws differential(double distance, double direction, double turn, const Alphas& alpha) {
  const double first = distance > kNoDirectionM ? direction : 0.0;
  const double second = wrapped(turn - first);
  const double turning = squared(folded(first)) + squared(folded(second));
  const double drift = alpha[1] * squared(distance);
  return {MotionModel::kDifferential,
          {first, distance, second},
          {std::sqrt(alpha[0] * squared(folded(first)) + drift),
           std::sqrt(alpha[2] * squared(distance) + alpha[3] * turning),
           std::sqrt(alpha[0] * squared(folded(second)) + drift)},
          0.0};
}

MotionDraws omnidirectional(double distance, double direction, double turn, const Alphas& alpha) {
  const double turning = squared(folded(turn));
  return {MotionModel::kOmnidirectional,
          {distance, turn, 0.0},
          {std::sqrt(alpha[2] * squared(distance) + alpha[3] * turning),
           std::sqrt(alpha[0] * turning + alpha[1] * squared(distance)),
           std::sqrt(alpha[4] * squared(distance) + alpha[3] * turning)},
          distance > kNoDirectionM ? direction : 0.0};
}

// Arrays of one block; plain pointers, for the vectoriser.
struct PoseBlock {
  double* __restrict__ x;
  double* __restrict__ y;
  double* __restrict__ yaw;
  std::size_t count;
};

// mean + sigma * number, per draw.
struct Scaled {
  double mean[3];
  double sigma[3];
  double bearing;
};

MAPPERD_VECTORISED void turn_go_turn(PoseBlock b, const Scaled& s, const NormalBlock& n) {
  const Scaled d = s;
  for (std::size_t i = 0; i < b.count; ++i) {
    const double first = d.mean[0] + d.sigma[0] * n.number[0][i];
    const double distance = d.mean[1] + d.sigma[1] * n.number[1][i];
    const double second = d.mean[2] + d.sigma[2] * n.number[2][i];
    const double heading = b.yaw[i] + first;
    const SineCosine along = fast_sine_cosine(heading);
    b.x[i] += distance * along.cosine;
    b.y[i] += distance * along.sine;
    b.yaw[i] = wrapped(heading + second);
  }
}

MAPPERD_VECTORISED void go_and_turn(PoseBlock b, const Scaled& s, const NormalBlock& n) {
  const Scaled d = s;
  for (std::size_t i = 0; i < b.count; ++i) {
    const double distance = d.mean[0] + d.sigma[0] * n.number[0][i];
    const double turn = d.mean[1] + d.sigma[1] * n.number[1][i];
    const double sideways = d.mean[2] + d.sigma[2] * n.number[2][i];
    const SineCosine along = fast_sine_cosine(b.yaw[i] + d.bearing);
    b.x[i] += distance * along.cosine + sideways * along.sine;
    b.y[i] += distance * along.sine - sideways * along.cosine;
    b.yaw[i] = wrapped(b.yaw[i] + turn);
  }
}

MAPPERD_VECTORISED void shake(PoseBlock b, const Scaled& s, const NormalBlock& n) {
  const Scaled d = s;
  for (std::size_t i = 0; i < b.count; ++i) {
    const double ahead = d.sigma[0] * n.number[0][i];
    const double port = d.sigma[1] * n.number[1][i];
    const SineCosine along = fast_sine_cosine(b.yaw[i]);
    b.x[i] += ahead * along.cosine - port * along.sine;
    b.y[i] += ahead * along.sine + port * along.cosine;
    b.yaw[i] = wrapped(b.yaw[i] + d.sigma[2] * n.number[2][i]);
  }
}

void apply(const PoseBlock& block, const MotionDraws& draws, const NormalBlock& normals) {
  const Scaled scaled{{draws.mean[0], draws.mean[1], draws.mean[2]},
                      {draws.sigma[0], draws.sigma[1], draws.sigma[2]},
                      draws.bearing_rad};
  switch (draws.model) {
    case MotionModel::kDifferential:
      return turn_go_turn(block, scaled, normals);
    case MotionModel::kOmnidirectional:
      return go_and_turn(block, scaled, normals);
    case MotionModel::kStationary:
      return shake(block, scaled, normals);
  }
}

void apply_floor(const PoseBlock& block, const MotionFloor& floor, const NormalBlock& normals) {
  for (std::size_t i = 0; i < block.count; ++i) {
    block.x[i] += floor.sigma_xy_m * normals.number[0][i];
    block.y[i] += floor.sigma_xy_m * normals.number[1][i];
    block.yaw[i] = wrapped(block.yaw[i] + floor.sigma_yaw_rad * normals.number[2][i]);
  }
}

}  // namespace

MotionDraws motion_draws(MotionModel model, const Pose2& before, const Pose2& now,
                         const Alphas& alphas) {
  if (!is_finite(before) || !is_finite(now)) {
    throw std::invalid_argument("odometry poses must be finite");
  }
  const double dx = now.x - before.x;
  const double dy = now.y - before.y;
  const double distance = std::hypot(dx, dy);
  const double direction = wrapped(std::atan2(dy, dx) - before.yaw);
  const double turn = wrapped(now.yaw - before.yaw);
  switch (model) {
    case MotionModel::kDifferential:
      return differential(distance, direction, turn, alphas);
    case MotionModel::kOmnidirectional:
      return omnidirectional(distance, direction, turn, alphas);
    case MotionModel::kStationary:
      break;
  }
  return {
      MotionModel::kStationary, {}, {kStationarySigma, kStationarySigma, kStationarySigma}, 0.0};
}

void move(Particles& particles, std::size_t first, std::size_t last, const MotionDraws& draws,
          const MotionFloor& floor, const Stream& stream) {
  NormalBlock normals;
  const bool has_floor = floor.sigma_xy_m > 0.0 || floor.sigma_yaw_rad > 0.0;
  for (std::size_t start = first; start < last; start += kBlock) {
    const std::size_t count = std::min(kBlock, last - start);
    const PoseBlock block{&particles.x[start], &particles.y[start], &particles.yaw[start], count};
    draw_normals(stream, Purpose::kMotion, start, count, normals);
    apply(block, draws, normals);
    if (!has_floor) continue;
    draw_normals(stream, Purpose::kFloor, start, count, normals);
    apply_floor(block, floor, normals);
  }
}

}  // namespace mapperd::localization
