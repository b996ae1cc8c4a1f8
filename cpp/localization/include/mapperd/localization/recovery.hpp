/// \file
/// \brief Augmented recovery: random particles when scans fit worse than before.
///
/// \par Threads
/// Const members may run concurrently; other members need exclusive access.
#pragma once

namespace mapperd::localization {

/// Two exponential averages of the scans' fit, both starting at the first value.
class Recovery {
 public:
  /// Gains in 0 ... 1, slow at most fast; both 0: no random particles.
  /// \throws std::invalid_argument for other gains.
  Recovery(double alpha_slow, double alpha_fast);

  void add(double fit);
  /// Share of particles to draw at random: 1 - fast / slow, within 0 ... 1.
  double injected_share() const;
  void reset() { begun_ = false; }

  struct Averages {
    double slow = 0.0;
    double fast = 0.0;
    bool begun = false;
  };
  Averages averages() const { return {slow_, fast_, begun_}; }
  void set_averages(const Averages& averages) {
    slow_ = averages.slow;
    fast_ = averages.fast;
    begun_ = averages.begun;
  }

 private:
  double alpha_slow_, alpha_fast_;
  double slow_ = 0.0;
  double fast_ = 0.0;
  bool begun_ = false;
};

}  // namespace mapperd::localization
