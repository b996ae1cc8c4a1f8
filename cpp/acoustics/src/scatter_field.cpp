#include <memory>
#include <vector>

#include "acoustics/bands.hpp"
#include "acoustics/deposit.hpp"
#include "acoustics/hearing.hpp"
#include "acoustics/lattice.hpp"
#include "acoustics/scatter.hpp"
#include "nodes.hpp"

namespace acoustics {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kRowsApart = 0.5;  // rows between nodes along the range, at most

// The scatterers of one hit after another, into a band's part of the field.
class Speckler {
 public:
  Speckler(const Echoes& echoes, const Band& band, std::complex<float>* field)
      : e_(echoes), band_(band), deposit_(echoes.response, field, band.columns), works_(echoes) {}

  void add(std::size_t hit) {
    if (!footprint_of(e_, hit, footprint_)) {
      return;
    }
    const double row_m = e_.grid.row_m / e_.grid.range_scale;
    const double end_m = row_m * static_cast<double>(e_.grid.rows);
    const double covered = (std::min(footprint_.far_m, end_m) - footprint_.near_m) / row_m;
    const Axes axes = axes_of(footprint_.normal);
    const double shadow = shadow_m2(footprint_.corner_m, axes);
    if (!(shadow > 0.0) || covered < -1.0) {
      return;
    }
    // Nodes beyond the last row would fall out: their share of the patch asks for none.
    const float* cell = e_.hits.cell + 4 * hit;
    const double wide = static_cast<double>(cell[1] - cell[0]) / e_.grid.sine_pitch;
    const double cells =
        std::max((footprint_.far_m - footprint_.near_m) / row_m, 1.0) * std::max(wide, 1.0);
    const Lattice lattice = lattice_at(hit, axes, shadow / (e_.laws.nodes_per_cell * cells), row_m);
    begin(hit, axes, lattice);
    scan_nodes(footprint_.corner_m, axes, lattice,
               [&](double i, double j) { node(node_key(lattice.key, i, j), i, j); });
    work();
  }

  void finish() { deposit_.flush(); }

 private:
  // Closer along the range than across: a row is much thinner than a beam is wide, and what a cell
  // hears is the more even the more of its nodes stand in line.
  Lattice lattice_at(std::size_t hit, const Axes& axes, double node_m2, double row_m) const {
    const std::array<Vector, 4>& corner = footprint_.corner_m;
    const Vector& origin = e_.hits.legs[e_.hits.seen[hit]].origin_m;
    const Vector& n = footprint_.normal;
    Vector d;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      d[axis] = 0.25 * (corner[0][axis] + corner[1][axis] + corner[2][axis] + corner[3][axis]) -
                origin[axis];
    }
    // How range grows over the lattice's plane.
    const double range_m = std::sqrt(std::max(dot(d, d), 1e-12));
    const double u = (d[axes.u] - d[axes.c] * n[axes.u] / n[axes.c]) / range_m;
    const double v = (d[axes.v] - d[axes.c] * n[axes.v] / n[axes.c]) / range_m;
    const double along_m =
        std::min(std::sqrt(node_m2), kRowsApart * row_m / std::max(std::sqrt(u * u + v * v), 1e-9));
    const int along = level_of(along_m);
    const int turn = static_cast<int>(std::lround(std::atan2(v, u) * kTurns / kPi)) & (kTurns - 1);
    return lattice_of(e_.laws.key, e_.faces.objects[e_.hits.face[hit]],
                      {axes, along, level_of(node_m2 / step_of(along)), turn});
  }

  void begin(std::size_t hit, const Axes& axes, const Lattice& lattice) {
    const Hits& hits = e_.hits;
    const int face = hits.face[hit];
    const std::int32_t smooth = e_.faces.smooth[face];
    const double* bent = smooth < 0 ? nullptr : e_.faces.bent + 12 * smooth;
    const double turn = bent != nullptr ? turn_per_m(bent) : 0.0;
    const double step_m = std::max(lattice.along_m, lattice.across_m);
    strength_ = Strength(e_.laws, e_.faces.table[e_.faces.materials[face]],
                         step_m * (turn + 1.0 / std::max(footprint_.near_m, 1e-3)));
    const Leg& transmit = hits.legs[hits.transmit[hit]];
    const Leg& receive = hits.legs[hits.receive[hit]];
    const double area_m2 =
        lattice.along_m * lattice.across_m / std::fabs(footprint_.normal[axes.c]);
    const double gain = hits.gain[hit] * transmit.gain * receive.gain * std::sqrt(area_m2);
    patch_ = {axes,
              footprint_.normal,
              e_.faces.planes[4 * face + 3],
              lattice,
              bent,
              &transmit,
              &receive,
              std::fabs(footprint_.transmit_height_m),
              std::fabs(footprint_.receive_height_m),
              static_cast<float>(gain)};
  }

  void node(std::uint64_t key, double i, double j) {
    constexpr double kUnit = 0x1p-16;
    const std::size_t at = nodes_.count++;
    nodes_.u[at] = i + static_cast<double>(key & 0xFFFFU) * kUnit;
    nodes_.v[at] = j + static_cast<double>(key >> 16 & 0xFFFFU) * kUnit;
    nodes_.bits[at] = static_cast<std::uint32_t>(key >> 32);
    if (nodes_.count == kNodes) {
      work();
    }
  }

  void work() {
    if (nodes_.count == 0) {
      return;
    }
    const HeardNodes& heard = works_.heard(patch_, strength_, nodes_);
    for (std::size_t i = 0; i < nodes_.count; ++i) {
      deposit(heard, i);
    }
    nodes_.count = 0;
  }

  void deposit(const HeardNodes& heard, std::size_t i) {
    const Spread at = spread_at(e_.response, heard.column[i]);
    const std::ptrdiff_t column = at.column - band_.column;
    const auto taps = static_cast<std::ptrdiff_t>(e_.response.tap_count);
    const std::ptrdiff_t row = heard.row[i];
    if (row < 0 || row >= e_.grid.rows || column < 0 || column + taps > band_.columns) {
      return;
    }
    deposit_.add(heard.pressure[i], heard.turns[i], nodes_.bits[i], row, column, at.fraction);
  }

  const Echoes& e_;
  const Band& band_;
  Deposit deposit_;
  NodeWorks works_;
  Footprint footprint_{};
  Strength strength_{Laws{}, Material{}, 0.0};
  PatchLaws patch_{};
  Nodes nodes_{};
};

using Part = std::unique_ptr<std::complex<float>[]>;

void add_part(const Band& band, const std::complex<float>* part, std::ptrdiff_t row,
              std::complex<float>* field_row) {
  const std::complex<float>* from = part + row * band.columns;
  for (std::ptrdiff_t column = 0; column < band.columns; ++column) {
    field_row[band.column + column] += from[column];
  }
}

}  // namespace

void scatter_field(const Echoes& echoes, std::complex<float>* field, int threads) {
  const std::vector<Band> bands = bands_of(echoes, threads);
  std::vector<Part> parts(bands.size());
  share(bands.size(), threads, [&](std::size_t i) {
    const Band& band = bands[i];
    parts[i] = std::make_unique<std::complex<float>[]>(static_cast<std::size_t>(echoes.grid.rows) *
                                                       static_cast<std::size_t>(band.columns));
    const auto speckler = std::make_unique<Speckler>(echoes, band, parts[i].get());
    for (std::size_t hit = band.first; hit < band.last; ++hit) {
      speckler->add(hit);
    }
    speckler->finish();
  });
  share(static_cast<std::size_t>(echoes.grid.rows), threads, [&](std::size_t row) {
    const auto at = static_cast<std::ptrdiff_t>(row);
    for (std::size_t i = 0; i < bands.size(); ++i) {
      add_part(bands[i], parts[i].get(), at, field + at * echoes.grid.columns);
    }
  });
}

}  // namespace acoustics
