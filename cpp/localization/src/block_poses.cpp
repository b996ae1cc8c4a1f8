#include "mapperd/localization/block_poses.hpp"

namespace mapperd::localization {

MAPPERD_VECTORISED void pose_block(const double* x, const double* y, const double* yaw,
                                   std::size_t count, const GridTransform& to_grid,
                                   BlockPoses& out) {
  const GridTransform l = to_grid;
  for (std::size_t i = 0; i < count; ++i) {
    const double dx = x[i] - l.origin_x;
    const double dy = y[i] - l.origin_y;
    const SineCosine turn = fast_sine_cosine(yaw[i] - l.yaw);
    out.u[i] = (l.cosine * dx + l.sine * dy) + 1.0;
    out.v[i] = (l.cosine * dy - l.sine * dx) + 1.0;
    out.cosine[i] = turn.cosine;
    out.sine[i] = turn.sine;
  }
  for (std::size_t i = count; i < kBlock; ++i) {
    out.u[i] = out.v[i] = out.sine[i] = 0.0;
    out.cosine[i] = 1.0;
  }
}

}  // namespace mapperd::localization
