/// \file
/// \brief The arc rule: the level of an echo tells which voxels of its arc it may come from.
///
/// An imaging sonar measures range and bearing, and not elevation: an echo may come from anywhere
/// on an arc. Its level is that of the loudest surface on the arc, and the beam's vertical pattern
/// is known. So a loud echo comes from near the beam's axis, and a quiet one excludes a surface
/// there. Voxels that other pings hold to be occupied explain an echo, and leave little of it to
/// the rest of the arc.
///
/// The definition. Arc cells are one voxel deep and the largest power of two of beams wide that a
/// voxel holds, one beam at least. The level x of an arc cell is its largest sample, relative to
/// the level of a surface on the axis. A surface at elevation e returns at most x with probability
///
///   F_e(x) = m + (1 - m) [(1 - b) Phi(ln(x / P(e)) / s) + b U(x)],
///
/// with the share m of surfaces that return nothing, the two-way amplitude pattern P, the spread s
/// (smaller below than above), and a log-uniform share b. Noise of median n returns at most x with
/// F_0(x) = 1 - (x / (3.5 n))^-1.82. The cell's level is the largest of independent sources, so
/// with the probabilities p_v of the arc's voxels before the ping
///
///   C(x) = F_0(x) prod_v (1 - p_v (1 - F_v(x)))^w,
///
/// w the voxels that the cell's share of the arc stands for; C_v leaves out voxel v. An observed
/// level between l and u changes the log-odds of a voxel by
///
///   ln [F_v(u) C_v(u) - F_v(l) C_v(l)] / [C_v(u) - C_v(l)].
///
/// \par Threads
/// Const members may run concurrently.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "mapperd/map/iwlo.hpp"

namespace mapperd::map {

/// How surfaces, the beam and silence are modelled; spreads and levels are as in the definition.
struct ArcParams {
  double half_aperture_rad = 0.2617993877991494;  ///< elevation up to which echoes are heard
  double beam_width_rad = 0.349065850398866;      ///< vertical, one way, -3 dB, full
  double spread_below = 0.45;                     ///< of the logarithm of a surface's level
  double spread_above = 1.0;
  double broad_share = 0.3;    ///< of surfaces of any level
  double missed_share = 0.01;  ///< of surfaces that return nothing
  double first_return = 0.45;  ///< smallest level of a first return
  double quiet = 3.0;          ///< levels up to so many times the noise are silence
  double behind_scale = 0.6;   ///< of steps downwards behind the first return
  double min_step = 0.3;       ///< behind the first return, smaller steps leave a voxel unobserved
  double max_step = 6.0;
};

/// Tables of a rule. \throws std::invalid_argument, naming the parameter, for values out of range.
class ArcModel {
 public:
  static constexpr int kLevels = 112;       ///< a twelfth of an octave each
  static constexpr int kUnitLevel = 60;     ///< index of level 1
  static constexpr int kNoiseLevels = 256;  ///< relative to the noise, from its median on
  static constexpr int kElevations = 64;    ///< uniform in sine

  ArcModel(const ArcParams& params, const IwloRule& rule);

  const ArcParams& params() const { return params_; }

  /// Log-odds by which silence lowers a voxel; what IwloParams::L_free of the map must be.
  static double free_step(const ArcParams& params);
  /// Elevation up to which a surface would be heard above the noise of this median.
  double heard_up_to(double noise) const;

  /// Place of a level and an elevation in the tables; of a level above noise, each in twelfths of
  /// an octave.
  static std::uint16_t place(int level, int elevation) {
    return static_cast<std::uint16_t>(level * kElevations + elevation);
  }
  static std::uint8_t noise_place(int level) {
    return static_cast<std::uint8_t>(level < 0 ? 0
                                               : (level < kNoiseLevels ? level : kNoiseLevels - 1));
  }
  /// Index of a level relative to that of a surface; noise may lie below the lowest, 0.
  static int index_of_noise(float level);
  static int index_of_level(float level);

  /// Voxels on arcs with an echo, each with the place of its arc's level in the tables.
  struct Voxels {
    std::size_t count;
    const std::int16_t* units;   ///< of the map before the ping
    const std::uint16_t* place;  ///< of level and elevation
    const std::uint8_t* noise;   ///< place of the level above noise
  };
  /// Logarithms of 1 - p (1 - F) at the upper and the lower level.
  void log_misses(const Voxels& voxels, float* upper, float* lower) const;
  /// Steps of log-odds. `upper` and `lower` are those of log_misses() and become scratch memory;
  /// `sum_upper` and `sum_lower` the sums over the voxels' arcs, weighted.
  void steps(const Voxels& voxels, float* upper, float* lower, const float* sum_upper,
             const float* sum_lower, float* step) const;

 private:
  double pattern(double sine) const;
  double below(double level, double sine) const;

  ArcParams params_;
  std::int16_t min_units_;
  std::vector<float> upper_;
  std::vector<float> lower_;
  std::vector<float> noise_upper_;
  std::vector<float> noise_lower_;
  std::vector<float> probability_;
};

}  // namespace mapperd::map
