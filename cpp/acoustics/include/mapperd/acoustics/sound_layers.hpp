/// \file
/// \brief Speeds of sound by depth, and the rays that they bend.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <vector>

namespace mapperd::acoustics {

/// Speeds by depth, linear in between and constant beyond. The functions below need one at least.
struct SoundLayers {
  std::vector<double> depth_m, speed_mps;  ///< depths increase
};

/// Growth of the speed of sound with height, per second; the speed itself goes to `speed_mps`.
double speed_gradient(const SoundLayers& layers, double depth_m, double& speed_mps);

/// Turns rays for their next straight pieces: elevation changes by -(dc/dz) cos / c along the way
/// (Snell). Turned from the middle of one piece to that of the next, a path is off by the square of
/// the step.
/// \param points (count, 3), z up, 0 at the sea's surface
/// \param directions (count, 3), unit vectors; turned in place
/// \param step_m length of the next piece
/// \param turn_m way over which it turns: `step_m`, and half of it for the first piece
/// \param speeds (count,), in the middle of the next piece
/// \param threads that share the rays, at most
void turn_rays(const SoundLayers& layers, std::size_t count, const double* points,
               double* directions, double step_m, double turn_m, double* speeds, unsigned threads);

/// Follows rays from a point over `steps` pieces.
/// \param directions (count, 3), in which they leave; turned in place
/// \param speed_mps that turns time into range
/// \param corners (steps + 1, count, 3): ends of the pieces
/// \param ranges_m (steps + 1, count): travel time to them, as a range
void follow_rays(const SoundLayers& layers, std::size_t count, const double* origin_m,
                 double* directions, double step_m, std::size_t steps, double speed_mps,
                 double* corners, double* ranges_m);

}  // namespace mapperd::acoustics
