#include "mapperd/localization/particles.hpp"

#include <cmath>

namespace mapperd::localization {

void Particles::resize(std::size_t count) {
  x.resize(count);
  y.resize(count);
  yaw.resize(count);
  log_weight.assign(count, -std::log(static_cast<double>(count)));
}

bool is_finite(const Pose2& pose) {
  return std::isfinite(pose.x) && std::isfinite(pose.y) && std::isfinite(pose.yaw);
}

}  // namespace mapperd::localization
