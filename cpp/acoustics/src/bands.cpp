#include "mapperd/acoustics/bands.hpp"

#include <algorithm>
#include <cmath>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/common/parallel.hpp"

namespace mapperd::acoustics {

namespace {

constexpr std::size_t kBands = 16;
constexpr double kJitterColumns = 2.0;  // scatterers lie up to half a lattice step outside a cell

// Sine at which a leg hears a point.
double sine_of(const Leg& leg, const Vec3& point_m) {
  const Vec3 d = point_m - leg.origin_m;
  const auto& m = leg.rotation;
  return -(m[1] * d.x + m[4] * d.y + m[7] * d.z) / std::sqrt(std::max(dot(d, d), 1e-12));
}

// Sines of bearing.
struct Interval {
  double low = 1.0, high = -1.0;

  void add(double sine) {
    low = std::min(low, sine);
    high = std::max(high, sine);
  }
};

// Widens an interval by the sines at which the given legs, one per hit, hear the hits. The leg that
// saw a hit hears it in its own cell.
void widen(const ScatterInput& echoes, const std::int32_t* legs, std::size_t first,
           std::size_t last, Interval& interval) {
  const RayHits& hits = echoes.hits;
  bool all_seen = true;
  for (std::size_t hit = first; hit < last; ++hit) {
    if (hits.face[hit] < 0) {
      continue;
    }
    if (hits.seen[hit] == legs[hit]) {
      const float* cell = hits.cell + 4 * hit;
      const float lean = hits.lean == nullptr ? 0.0F : std::fabs(hits.lean[2 * hit]);
      const float off = 0.5F * lean * (cell[3] - cell[2]);
      interval.add(cell[0] - off);
      interval.add(cell[1] + off);
    } else {
      all_seen = false;
    }
  }
  Footprints patches;
  for (std::size_t next = first; next < last && !all_seen;) {
    next = footprints_of(echoes, next, last, patches);
    for (std::size_t i = 0; i < patches.count; ++i) {
      const std::size_t hit = patches.hit[i];
      if (!patches.exists[i] || hits.seen[hit] == legs[hit]) {
        continue;
      }
      const auto& corner_m = patches.corner_m;
      for (std::size_t k = 0; k < 4; ++k) {
        interval.add(sine_of(hits.legs[legs[hit]],
                             {corner_m[0][k][i], corner_m[1][k][i], corner_m[2][k][i]}));
      }
    }
  }
}

// First hit of a part of the fan; hits come in the order of their columns.
std::size_t first_from(const ScatterInput& echoes, std::size_t part) {
  if (part == 0 || part >= kBands) {
    return part == 0 ? 0 : echoes.hits.count;
  }
  const EchoGrid& grid = echoes.grid;
  const double wide = static_cast<double>(grid.columns) * grid.sine_pitch;
  const double sine =
      grid.first_sine + wide * static_cast<double>(part) / static_cast<double>(kBands);
  std::size_t from = 0;
  std::size_t to = echoes.hits.count;
  while (from < to) {
    const std::size_t middle = from + (to - from) / 2;
    if (echoes.hits.cell[4 * middle] < sine) {
      from = middle + 1;
    } else {
      to = middle;
    }
  }
  return from;
}

Band band_of(const ScatterInput& echoes, std::size_t first, std::size_t last) {
  Interval heard;
  widen(echoes, echoes.hits.receive, first, last, heard);
  if (echoes.hits.both_ways) {
    widen(echoes, echoes.hits.transmit, first, last, heard);
  }
  if (heard.low > heard.high) {
    return {first, first, 0, 0};
  }
  const double reach = static_cast<double>(echoes.response.tap_count) + kJitterColumns;
  const double most = static_cast<double>(echoes.grid.columns);
  const double from = std::clamp(column_of(echoes.grid, heard.low) - reach, 0.0, most);
  const double to = std::clamp(column_of(echoes.grid, heard.high) + reach, 0.0, most);
  const auto column = static_cast<std::ptrdiff_t>(from);
  return {first, last, column, static_cast<std::ptrdiff_t>(std::ceil(to)) - column};
}

}  // namespace

std::vector<Band> bands_of(const ScatterInput& echoes, int threads) {
  // Cut by bearing, not by number: what is out of earshot then shifts no hit to another band.
  std::vector<Band> bands(kBands);
  run_parallel(kBands, threads, [&](std::size_t i) {
    bands[i] = band_of(echoes, first_from(echoes, i), first_from(echoes, i + 1));
  });
  return bands;
}

void in_bands(const std::vector<Band>& bands, int threads,
              const std::function<void(const Band&)>& task) {
  // Each band joins the first round whose bands all lie beside it.
  std::vector<std::vector<const Band*>> rounds;
  for (const Band& band : bands) {
    const auto beside = [&band](const Band* other) {
      return other->column + other->columns <= band.column ||
             band.column + band.columns <= other->column;
    };
    auto round = std::find_if(rounds.begin(), rounds.end(), [&beside](const auto& others) {
      return std::all_of(others.begin(), others.end(), beside);
    });
    if (round == rounds.end()) {
      round = rounds.insert(rounds.end(), std::vector<const Band*>{});
    }
    round->push_back(&band);
  }
  for (const auto& round : rounds) {
    run_parallel(round.size(), threads, [&](std::size_t i) { task(*round[i]); });
  }
}

double column_of(const EchoGrid& grid, double s) { return (s - grid.first_sine) / grid.sine_pitch; }

}  // namespace mapperd::acoustics
