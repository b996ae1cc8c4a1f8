#include "mapperd/localization/scan_search.hpp"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "mapperd/common/fast_math.hpp"
#include "mapperd/common/parallel.hpp"
#include "mapperd/localization/log_weights.hpp"
#include "mapperd/localization/resample.hpp"

namespace mapperd::localization {
namespace {

constexpr std::size_t kPosesATask = 64 * kBlock;
constexpr std::size_t kMaxPoses = 10'000'000;

template <typename Task>
void in_blocks(std::size_t count, int threads, const Task& task) {
  run_parallel((count + kPosesATask - 1) / kPosesATask, threads, [&](std::size_t k) {
    task(k * kPosesATask, std::min(count, (k + 1) * kPosesATask));
  });
}

void jitter(Particles& particles, std::size_t first, std::size_t last, const Search& search,
            const Stream& stream) {
  NormalBlock normals;
  for (std::size_t start = first; start < last; start += kBlock) {
    const std::size_t count = std::min(kBlock, last - start);
    draw_normals(stream, Purpose::kFloor, start, count, normals);
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = start + k;
      particles.x[i] += search.jitter_m * normals.number[0][k];
      particles.y[i] += search.jitter_m * normals.number[1][k];
      particles.yaw[i] = wrapped(particles.yaw[i] + search.jitter_rad * normals.number[2][k]);
    }
  }
}

}  // namespace

Particles drawn_by_scan(const FreeSpace& free, const LikelihoodField& field, const Endpoints& ends,
                        const Search& search, std::size_t count, const Stream& stream,
                        int threads) {
  if (search.poses < count || search.poses > kMaxPoses) {
    throw std::invalid_argument("a search needs as many poses as particles, and at most 10000000");
  }
  Particles anywhere;
  anywhere.resize(search.poses);
  std::vector<double> logs(search.poses);
  in_blocks(search.poses, threads, [&](std::size_t first, std::size_t last) {
    for (std::size_t i = first; i < last; ++i) {
      anywhere.set(i, free.draw_pose(stream, Purpose::kStart, static_cast<std::uint32_t>(i)));
    }
    field_log_likelihoods(field, ends, BeamAggregation::kProduct, search.kappa, anywhere, first,
                          last, logs.data());
  });
  // The cloud's particles are to come from about as many poses.
  const double share = static_cast<double>(count) / static_cast<double>(search.poses);
  const double exponent = bearable_exponent(anywhere.log_weight, logs, share);
  for (double& value : logs) value *= exponent;
  reweight(anywhere.log_weight, logs);
  const std::vector<std::size_t> parent = comb(linear_weights(anywhere.log_weight), count, 0.5);
  Particles drawn;
  drawn.resize(count);
  for (std::size_t i = 0; i < count; ++i) drawn.set(i, anywhere.pose(parent[i]));
  jitter(drawn, 0, count, search, stream);
  return drawn;
}

}  // namespace mapperd::localization
