/// \file
/// \brief Poses drawn from a Gaussian.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

/// Returns a matrix S with S S^T = covariance (x, y, yaw; m^2, m rad, rad^2), of rank 0 to 3.
/// Asymmetry below 1e-9 is evened out, and eigenvalues above -1e-9 of the largest count as 0.
/// \throws std::invalid_argument for anything else, and for values that are not finite.
Matrix3 square_root_of(const Matrix3& covariance);

/// Fills the cloud with draws; weights do not change.
void draw_about(const Pose2& mean, const Matrix3& root, const Stream& stream, Particles& particles);

}  // namespace mapperd::localization
