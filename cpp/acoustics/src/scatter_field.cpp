#include <algorithm>
#include <cstring>
#include <memory>

#include "mapperd/acoustics/bands.hpp"
#include "mapperd/acoustics/deposit.hpp"
#include "mapperd/acoustics/echo_response.hpp"
#include "mapperd/acoustics/scatter.hpp"
#include "nodes.hpp"

namespace mapperd::acoustics {

namespace {

// Indices of some nodes in a row, as one value to the compiler.
using Indices = std::int32_t __attribute__((vector_size(kLanes * sizeof(std::int32_t))));
constexpr Indices kEach = {0, 1, 2, 3, 4, 5, 6, 7};

// The scatterers of one hit after another, into a band of the field.
class SpeckleKernel {
 public:
  SpeckleKernel(const ScatterInput& echoes, const Band& band, std::complex<float>* field)
      : e_(echoes),
        deposit_(echoes.response, echoes.grid, band.column, band.columns, field),
        kernel_(echoes) {}

  // Takes the hits of a batch; returns the next one.
  std::size_t add(std::size_t first, std::size_t last) {
    const std::size_t next = footprints_of(e_, first, last, footprints_);
    make_patches(e_, footprints_, patches_);
    for (patch_ = 0; patch_ < footprints_.count; ++patch_) {
      if (patches_.exists[patch_]) {
        begin(footprints_.hit[patch_]);
        fill();
        placed();
      }
    }
    return next;
  }

  void finish() { work(); }

 private:
  void begin(std::size_t hit) {
    const RayHits& hits = e_.hits;
    const Face& face = e_.faces.table[hits.face[hit]];
    const double per_m = face.turn_per_m + 1.0 / std::max(footprints_.near_m[patch_], 1e-3);
    strength_ =
        Strength(e_.model, e_.faces.materials[face.material], patches_.step_m[patch_] * per_m);
    const Leg& transmit = hits.legs[hits.transmit[hit]];
    const Leg& receive = hits.legs[hits.receive[hit]];
    const SharedTraits traits{&transmit, face.smooth >= 0, &receive, strength_.has_lobe()};
    if (!(traits == traits_)) {
      work();
      traits_ = traits;
    }
    gain_ = hits.gain[hit] * transmit.gain * receive.gain * patches_.root_area_m[patch_];
  }

  // Takes the patch's nodes.
  void fill() {
    const Outlines& outlines = patches_.outline;
    const bool turned = outlines.turned[patch_];
    std::int32_t* along = turned ? nodes_.j : nodes_.i;
    std::int32_t* across = turned ? nodes_.i : nodes_.j;
    const auto lines = static_cast<std::size_t>(outlines.lines[patch_]);
    for (std::size_t from = 0; from < lines; from += kLines) {
      scan(outlines, patch_, from, lines_);
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
      place(footprints_, patches_, patch_, strength_, gain_, traits_, placed_, nodes_);
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
  Footprints footprints_{};
  Patches patches_{};
  std::size_t patch_ = 0;  // of the batch
  Strength strength_{ScatterModel{}, Material{}, 0.0};
  double gain_ = 0.0;      // of pressure, the node's area included
  SharedTraits traits_{};  // of the nodes
  Nodes nodes_{};
  Lines lines_{};
  std::size_t placed_ = 0;
};

}  // namespace

void scatter_field(const ScatterInput& echoes, std::complex<float>* field, int threads) {
  in_bands(bands_of(echoes, threads), threads, [&](const Band& band) {
    if (band.columns < static_cast<std::ptrdiff_t>(echoes.response.tap_count)) {
      return;
    }
    const auto speckler = std::make_unique<SpeckleKernel>(echoes, band, field);
    for (std::size_t hit = band.first; hit < band.last;) {
      hit = speckler->add(hit, band.last);
    }
    speckler->finish();
  });
}

}  // namespace mapperd::acoustics
