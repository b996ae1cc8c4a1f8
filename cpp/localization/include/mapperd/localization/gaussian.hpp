// Poses drawn about a mean.
#pragma once

#include "mapperd/localization/draws.hpp"
#include "mapperd/localization/particles.hpp"

namespace mapperd::localization {

// A matrix S with S S^T = covariance, of rank 0 to 3. Asymmetry below 1e-9 is evened out, and
// eigenvalues above -1e-9 of the largest count as 0.
// Throws std::invalid_argument for anything else, and for values that are not finite.
Matrix3 square_root_of(const Matrix3& covariance);

// Fills the cloud with draws; weights are left alone.
void draw_about(const Pose2& mean, const Matrix3& root, const Stream& stream, Particles& particles);

}  // namespace mapperd::localization
