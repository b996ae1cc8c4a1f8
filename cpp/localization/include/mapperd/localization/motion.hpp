/// \file
/// \brief Motion models: move a particle cloud by one odometry step with noise.
#pragma once

#include <array>

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

/// How a vehicle moves between two odometry poses.
enum class MotionModel { kDifferential, kOmnidirectional, kStationary };

/// Noise variances by motion squared: of rotation from rotation, of rotation from translation
/// (rad^2/m^2), of translation from translation, of translation from rotation (m^2/rad^2), and of
/// sideways motion from translation (omnidirectional only).
using Alphas = std::array<double, 5>;

/// One step's three independent normal numbers, by model:
///   differential: first turn, translation, second turn;
///   omnidirectional: translation, turn, sideways, with the translation's bearing seen from the
///   base; stationary: ahead, to port, turn.
struct MotionDraws {
  MotionModel model = MotionModel::kDifferential;
  std::array<double, 3> mean{};
  std::array<double, 3> sigma{};
  double bearing_rad = 0.0;
};

/// Noise that grows with time instead of motion: standard deviations of this step, in the map
/// frame.
struct MotionFloor {
  double sigma_xy_m = 0.0;
  double sigma_yaw_rad = 0.0;
};

/// Returns the distribution of the step between two odometry poses (m, rad, odometry frame).
/// A turn of about half a turn is as noisy as no turn, so that driving backwards adds no noise.
/// Translations up to 1 cm have no direction.
/// \throws std::invalid_argument for poses that are not finite.
MotionDraws motion_draws(MotionModel model, const Pose2& before, const Pose2& now,
                         const Alphas& alphas);

/// Moves particles first ... last - 1; each has its own draws. Threads: disjoint ranges may run
/// concurrently.
void move(Particles& particles, std::size_t first, std::size_t last, const MotionDraws& draws,
          const MotionFloor& floor, const Stream& stream);

}  // namespace mapperd::localization
