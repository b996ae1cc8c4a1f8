#include <algorithm>
#include <cmath>

#include "mapperd/common/fast_math.hpp"
#include "nodes.hpp"

namespace mapperd::acoustics {

namespace {

double min_of(const double* x) { return std::min(std::min(x[0], x[1]), std::min(x[2], x[3])); }
double max_of(const double* x) { return std::max(std::max(x[0], x[1]), std::max(x[2], x[3])); }

constexpr std::size_t kLinesAtOnce = 4;  // most patches have fewer lines

// Where a line crosses the sides. Loops run to a multiple of the vectors' length.
MAPPERD_VECTORISED void cross(const Outline& o, double row, std::size_t count,
                              std::int32_t* __restrict first, std::int32_t* __restrict nodes) {
  for (std::size_t start = 0; start < count; start += kLinesAtOnce) {
    for (std::size_t i = start; i < start + kLinesAtOnce; ++i) {
      const double at = row + static_cast<double>(static_cast<std::int32_t>(i));
      double from = HUGE_VAL;
      double to = -HUGE_VAL;
      for (std::size_t k = 0; k < 4; ++k) {
        const double crossing = o.along[k] + (at - o.across[k]) * o.lean[k];
        const bool crosses = (o.across[k] <= at) != (o.across[(k + 1) % 4] <= at);
        const double low = crosses ? crossing : HUGE_VAL;
        const double high = crosses ? crossing : -HUGE_VAL;
        from = low < from ? low : from;
        to = high > to ? high : to;
      }
      const double begin = std::ceil(from) - o.first_along;
      const double end = std::ceil(to) - o.first_along;
      const bool some = begin < end;
      first[i] = static_cast<std::int32_t>(some ? begin : 0.0);
      nodes[i] = static_cast<std::int32_t>(some ? end - begin : 0.0);
    }
  }
}

}  // namespace

Outline outline_of(const Corners& corner_m, const Axes& axes, const Lattice& lattice) {
  const double along_u = lattice.cosine / lattice.along_m;
  const double along_v = lattice.sine / lattice.along_m;
  const double across_u = -lattice.sine / lattice.across_m;
  const double across_v = lattice.cosine / lattice.across_m;
  double u[4];
  double v[4];
  for (std::size_t k = 0; k < 4; ++k) {
    const double at_u = corner_m[axes.u][k];
    const double at_v = corner_m[axes.v][k];
    u[k] = at_u * along_u + at_v * along_v - lattice.i0;
    v[k] = at_u * across_u + at_v * across_v - lattice.j0;
  }
  Outline o;
  const double low_u = min_of(u), high_u = max_of(u);
  const double low_v = min_of(v), high_v = max_of(v);
  // Long lines are quicker than many.
  o.turned = high_v - low_v > high_u - low_u;
  std::copy_n(o.turned ? v : u, 4, o.along);
  std::copy_n(o.turned ? u : v, 4, o.across);
  for (std::size_t k = 0; k < 4; ++k) {
    const std::size_t n = (k + 1) % 4;
    o.lean[k] = (o.along[n] - o.along[k]) / (o.across[n] - o.across[k]);
  }
  o.first_along = std::ceil(o.turned ? low_v : low_u);
  o.first_across = std::ceil(o.turned ? low_u : low_v);
  o.lines = static_cast<std::size_t>(std::ceil(o.turned ? high_u : high_v) - o.first_across);
  return o;
}

void scan(const Outline& outline, std::size_t from, Lines& lines) {
  lines.size = std::min(outline.lines - from, kLines);
  cross(outline, outline.first_across + static_cast<double>(from), lines.size, lines.first,
        lines.count);
}

}  // namespace mapperd::acoustics
