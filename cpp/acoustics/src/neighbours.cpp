#include "mapperd/acoustics/neighbours.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/common/vec.hpp"

namespace mapperd::acoustics {

namespace {

constexpr float kAtSameHeight = 1e-6F;  // sine of elevation

// Whether two hits of the standing scene are of different surfaces, or far apart on a round one.
bool differ(const TracedRays& rays, std::size_t low, const float* normals,
            const std::int32_t* smooth, const SurfaceCriteria& same) {
  const std::size_t high = low + 1;
  if (rays.face[low] == rays.face[high] && smooth[rays.face[low]] < 0) {
    return false;
  }
  float step[3];
  for (std::size_t axis = 0; axis < 3; ++axis) {
    step[axis] = rays.direction[3 * high + axis] * rays.range_m[high] -
                 rays.direction[3 * low + axis] * rays.range_m[low];
  }
  const float* below = normals + 3 * rays.face[low];
  const float* above = normals + 3 * rays.face[high];
  const float allowed = same.max_slope * std::sqrt(dot3(step, step)) + same.min_step_m;
  if (std::fabs(dot3(below, step)) > allowed || std::fabs(dot3(above, step)) > allowed) {
    return true;
  }
  return smooth[rays.face[high]] >= 0 && dot3(below, above) < same.min_cosine;
}

bool is_edge(const TracedRays& rays, std::size_t low, const float* normals,
             const std::int32_t* smooth, const SurfaceCriteria& same) {
  const std::size_t high = low + 1;
  if (rays.column[low] != rays.column[high]) {
    return false;
  }
  if (rays.face[low] < 0 || rays.face[high] < 0) {
    return (rays.face[low] < 0) != (rays.face[high] < 0);
  }
  if (rays.group[low] != rays.group[high]) {
    return true;
  }
  return rays.group[high] == rays.standing && differ(rays, low, normals, smooth, same);
}

// Ranges between which neighbours met what a ray met.
class Spans {
 public:
  Spans(const TracedRays& rays, const std::int32_t* surface, float* span_m)
      : rays_(rays), surface_(surface), span_m_(span_m) {
    for (std::size_t i = 0; i < rays.count; ++i) {
      span_m[2 * i] = span_m[2 * i + 1] = rays.face[i] < 0 ? 0.0F : rays.range_m[i];
    }
  }

  // Each of two rays learns from the other.
  void meet(std::size_t one, std::size_t other) {
    if (rays_.face[one] < 0 || rays_.face[other] < 0 ||
        surface_[rays_.face[one]] != surface_[rays_.face[other]]) {
      return;
    }
    take_in(one, rays_.range_m[other]);
    take_in(other, rays_.range_m[one]);
  }

  void widen(const float* size_m) {
    for (std::size_t i = 0; i < rays_.count; ++i) {
      if (rays_.face[i] >= 0) {
        const float size = size_m[rays_.face[i]];
        const float range_m = rays_.range_m[i];
        span_m_[2 * i] = std::max(std::min(span_m_[2 * i], range_m - size), 0.0F);
        span_m_[2 * i + 1] = std::max(span_m_[2 * i + 1], range_m + size);
      }
    }
  }

 private:
  void take_in(std::size_t ray, float range_m) {
    span_m_[2 * ray] = std::min(span_m_[2 * ray], range_m);
    span_m_[2 * ray + 1] = std::max(span_m_[2 * ray + 1], range_m);
  }

  const TracedRays& rays_;
  const std::int32_t* surface_;
  float* span_m_;
};

std::size_t column_end(const TracedRays& rays, std::size_t first) {
  std::size_t end = first;
  while (end < rays.count && rays.column[end] == rays.column[first]) {
    ++end;
  }
  return end;
}

}  // namespace

std::vector<std::int64_t> edges(const TracedRays& rays, const float* normals,
                                const std::int32_t* smooth, const SurfaceCriteria& same) {
  std::vector<std::int64_t> found;
  for (std::size_t i = 0; i + 1 < rays.count; ++i) {
    if (is_edge(rays, i, normals, smooth, same)) {
      found.push_back(static_cast<std::int64_t>(i));
    }
  }
  return found;
}

void spans(const TracedRays& rays, const float* up, const std::int32_t* surface,
           const float* size_m, float* span_m) {
  Spans spans(rays, surface, span_m);
  for (std::size_t i = 0; i + 1 < rays.count; ++i) {
    if (rays.column[i] == rays.column[i + 1]) {
      spans.meet(i, i + 1);
    }
  }
  for (std::size_t first = 0; first < rays.count;) {
    const std::size_t end = column_end(rays, first);
    const std::size_t next_end = end < rays.count ? column_end(rays, end) : end;
    const bool beside = next_end > end && rays.column[end] == rays.column[first] + 1;
    // The next column's ray as high as each of this one's, or the first above it.
    for (std::size_t other = end; beside && first < end; ++first) {
      while (other < next_end && up[other] < up[first] - kAtSameHeight) {
        ++other;
      }
      if (other < next_end) {
        spans.meet(first, other);
      }
    }
    first = end;
  }
  spans.widen(size_m);
}

}  // namespace mapperd::acoustics
