#include <cstring>
#include <memory>
#include <vector>

#include "mapperd/acoustics/bands.hpp"
#include "mapperd/acoustics/deposit.hpp"
#include "mapperd/acoustics/hearing.hpp"
#include "mapperd/acoustics/lattice.hpp"
#include "mapperd/acoustics/scatter.hpp"
#include "nodes.hpp"

namespace mapperd::acoustics {

namespace {

constexpr std::size_t kPrefetchFace = 16, kPrefetchNormal = 6;  // hits ahead
constexpr double kWholeCell = 0.999;  // columns: a narrower cell is one that an outline has cut
constexpr double kSmallTurn = 0.3;  // rad, by which the surface of a small object turns in a patch
constexpr double kMinSmallNodes = 8.0;  // of a patch of a small object
constexpr double kRowsApart = 0.5;      // rows between nodes along the range, at most

// Indices of some nodes in a row, as one value to the compiler.
using Indices = std::int32_t __attribute__((vector_size(kLanes * sizeof(std::int32_t))));
constexpr Indices kEach = {0, 1, 2, 3, 4, 5, 6, 7};

// The scatterers of one hit after another, into a band of the field.
class Speckler {
 public:
  Speckler(const ScatterInput& echoes, const Band& band, std::complex<float>* field)
      : e_(echoes),
        deposit_(echoes.response, echoes.grid, band.column, band.columns, field),
        kernel_(echoes) {}

  void add(std::size_t hit) {
    if (e_.hits.face[hit] < 0 || !footprint_of(e_, hit, footprint_)) {
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
    double nodes = e_.model.nodes_per_cell * cells;
    const Face& face = e_.faces.table[e_.hits.face[hit]];
    // Few patches may be all that there is of a small object: its surface turns within one.
    if (wide < kWholeCell || face.turn_per_m * std::sqrt(shadow) > kSmallTurn) {
      nodes = std::max(nodes, kMinSmallNodes);
    }
    const Lattice lattice = lattice_at(hit, face, axes, shadow / nodes, row_m);
    begin(hit, face, axes, lattice);
    fill();
    placed();
  }

  void finish() { work(); }

 private:
  // Closer along the range than across: a row is much thinner than a beam is wide, and what a cell
  // hears is the more even the more of its nodes stand in line.
  Lattice lattice_at(std::size_t hit, const Face& face, const Axes& axes, double node_m2,
                     double row_m) const {
    const Corners& corner = footprint_.corner_m;
    const Vec3& origin = e_.hits.legs[e_.hits.seen[hit]].origin_m;
    const Vec3& n = footprint_.normal;
    Vec3 d;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::array<double, 4>& at = corner[axis];
      d[axis] = 0.25 * (at[0] + at[1] + at[2] + at[3]) - origin[axis];
    }
    // How range grows over the lattice's plane.
    const double range_m = std::sqrt(std::max(dot(d, d), 1e-12));
    const double u = (d[axes.u] - d[axes.c] * n[axes.u] / n[axes.c]) / range_m;
    const double v = (d[axes.v] - d[axes.c] * n[axes.v] / n[axes.c]) / range_m;
    const double along_m =
        std::min(std::sqrt(node_m2), kRowsApart * row_m / std::max(std::sqrt(u * u + v * v), 1e-9));
    const int along = level_of(along_m);
    return lattice_of(e_.model.key, face.object,
                      {axes, along, level_of(node_m2 / step_of(along)), turn_of(u, v)});
  }

  void begin(std::size_t hit, const Face& face, const Axes& axes, const Lattice& lattice) {
    const RayHits& hits = e_.hits;
    const double* curved_normal =
        face.smooth < 0 ? nullptr : e_.faces.curved_normal + 12 * face.smooth;
    const double step_m = std::max(lattice.along_m, lattice.across_m);
    const Strength strength(e_.model, e_.faces.materials[face.material],
                            step_m * (face.turn_per_m + 1.0 / std::max(footprint_.near_m, 1e-3)));
    const Leg& transmit = hits.legs[hits.transmit[hit]];
    const Leg& receive = hits.legs[hits.receive[hit]];
    const SharedTraits traits{&transmit, &receive, curved_normal != nullptr, strength.has_lobe()};
    if (!(traits == traits_)) {
      work();
      traits_ = traits;
    }
    const double area_m2 =
        lattice.along_m * lattice.across_m / std::fabs(footprint_.normal[axes.c]);
    const double gain = hits.gain[hit] * transmit.gain * receive.gain * std::sqrt(area_m2);
    patch_ = {axes,
              footprint_.normal,
              face.plane[3],
              lattice,
              0.0,
              0.0,
              curved_normal,
              std::fabs(footprint_.transmit_height_m),
              std::fabs(footprint_.receive_height_m),
              static_cast<float>(gain),
              strength};
  }

  // Takes the patch's nodes.
  void fill() {
    const Outline outline = outline_of(footprint_.corner_m, patch_.axes, patch_.lattice);
    patch_.first_i = outline.turned ? outline.first_across : outline.first_along;
    patch_.first_j = outline.turned ? outline.first_along : outline.first_across;
    std::int32_t* along = outline.turned ? nodes_.j : nodes_.i;
    std::int32_t* across = outline.turned ? nodes_.i : nodes_.j;
    for (std::size_t from = 0; from < outline.lines; from += kLines) {
      scan(outline, from, lines_);
      for (std::size_t line = 0; line < lines_.size; ++line) {
        take(lines_.first[line], lines_.count[line], static_cast<std::int32_t>(from + line), along,
             across);
      }
    }
  }

  void take(std::int32_t first, std::int32_t count, std::int32_t line, std::int32_t* along,
            std::int32_t* across) {
    while (count > 0) {
      const auto some = std::min(count, static_cast<std::int32_t>(kNodes - nodes_.count));
      // Whole vectors: what is written too much is overwritten or not read.
      for (std::int32_t k = 0; k < some; k += static_cast<std::int32_t>(kLanes)) {
        const std::size_t at = nodes_.count + static_cast<std::size_t>(k);
        const Indices indices = kEach + (first + k);
        const Indices lines = Indices{} + line;
        std::memcpy(along + at, &indices, sizeof indices);
        std::memcpy(across + at, &lines, sizeof lines);
      }
      nodes_.count += static_cast<std::size_t>(some);
      first += some;
      count -= some;
      if (nodes_.count == kNodes) {
        placed();
        work();
      }
    }
  }

  // Done with what belongs to the patch, for its nodes so far.
  void placed() {
    if (placed_ < nodes_.count) {
      place(patch_, traits_, placed_, nodes_);
      placed_ = nodes_.count;
    }
  }

  void work() {
    if (nodes_.count > 0) {
      const HeardNodes& heard = kernel_.heard(traits_, nodes_);
      Scatterers scatterers{nodes_.count, heard.pressure, heard.turns,
                            nodes_.bits,  heard.row,      heard.column};
      deposit_.add(scatterers);
      if (e_.hits.both_ways) {
        scatterers.column = heard.other_column;
        deposit_.add(scatterers);
      }
    }
    nodes_.count = 0;
    placed_ = 0;
  }

  const ScatterInput& e_;
  Deposit deposit_;
  ScattererKernel kernel_;
  Footprint footprint_{};
  PatchModel patch_{
      {}, {}, 0.0, {}, 0.0, 0.0, nullptr, 0.0, 0.0, 0.0F, {ScatterModel{}, Material{}, 0.0}};
  SharedTraits traits_{};  // of the nodes
  Nodes nodes_{};
  Lines lines_{};
  std::size_t placed_ = 0;
};

// Asks for a face's entry before it is needed, and for what it points to when it has come.
void fetch(const ScatterInput& echoes, std::size_t soon, std::size_t next) {
#if defined(__GNUC__)
  __builtin_prefetch(echoes.faces.table + std::max(echoes.hits.face[soon], 0));
  const std::int32_t face = echoes.hits.face[next];
  const std::int32_t smooth = face < 0 ? -1 : echoes.faces.table[face].smooth;
  if (smooth >= 0) {
    __builtin_prefetch(echoes.faces.curved_normal + 12 * smooth);
    __builtin_prefetch(echoes.faces.curved_normal + 12 * smooth + 8);
  }
#endif
}

}  // namespace

void scatter_field(const ScatterInput& echoes, std::complex<float>* field, int threads) {
  in_bands(bands_of(echoes, threads), threads, [&](const Band& band) {
    if (band.columns < static_cast<std::ptrdiff_t>(echoes.response.tap_count)) {
      return;
    }
    const auto speckler = std::make_unique<Speckler>(echoes, band, field);
    for (std::size_t hit = band.first; hit < band.last; ++hit) {
      fetch(echoes, std::min(hit + kPrefetchFace, band.last - 1),
            std::min(hit + kPrefetchNormal, band.last - 1));
      speckler->add(hit);
    }
    speckler->finish();
  });
}

}  // namespace mapperd::acoustics
