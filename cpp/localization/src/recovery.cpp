#include "mapperd/localization/recovery.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace mapperd::localization {

Recovery::Recovery(double alpha_slow, double alpha_fast)
    : alpha_slow_(alpha_slow), alpha_fast_(alpha_fast) {
  if (!(alpha_slow >= 0.0 && alpha_slow <= alpha_fast && alpha_fast <= 1.0)) {
    throw std::invalid_argument("recovery gains must be 0 <= slow <= fast <= 1");
  }
}

void Recovery::add(double fit) {
  if (!std::isfinite(fit)) return;
  slow_ = begun_ ? slow_ + alpha_slow_ * (fit - slow_) : fit;
  fast_ = begun_ ? fast_ + alpha_fast_ * (fit - fast_) : fit;
  begun_ = true;
}

double Recovery::injected_share() const {
  if (!begun_ || std::abs(slow_) < std::numeric_limits<double>::min()) return 0.0;
  return std::clamp(1.0 - fast_ / slow_, 0.0, 1.0);
}

}  // namespace mapperd::localization
