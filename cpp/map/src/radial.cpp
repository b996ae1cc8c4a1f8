#include "mapperd/map/radial.hpp"

namespace mapperd::map {
namespace {

double potential_of(double r, double value, double flux, double offset) {
  return (r > 0 ? -flux / r : 0.0) + value * r * r / 6 + offset;
}

}  // namespace

Two RadialProfile::potential(double r) const {
  if (empty() || r <= start_m()) return {};
  const RadialPiece& p = pieces_[index_at(r)];
  return {potential_of(r, p.value.part, p.flux.part, p.offset.part),
          potential_of(r, p.value.weight, p.flux.weight, p.offset.weight)};
}

void RadialBuilder::add(double near_m, const Two& value) {
  // C and D run on without a jump from the piece before.
  const auto join = [near_m](double f, double c, double d, double& flux, double& offset) {
    flux = c - f * near_m * near_m * near_m / 3;
    offset = d - potential_of(near_m, f, flux, 0.0);
  };
  RadialPiece piece{near_m, value, {}, {}};
  Two c;
  Two d;
  if (!first_) {
    const RadialPiece& last = pieces_.back();
    const double third = near_m * near_m * near_m / 3;
    c = {last.flux.part + last.value.part * third, last.flux.weight + last.value.weight * third};
    d = {potential_of(near_m, last.value.part, last.flux.part, last.offset.part),
         potential_of(near_m, last.value.weight, last.flux.weight, last.offset.weight)};
  }
  join(value.part, c.part, d.part, piece.flux.part, piece.offset.part);
  join(value.weight, c.weight, d.weight, piece.flux.weight, piece.offset.weight);
  pieces_.push_back(piece);
  first_ = false;
}

}  // namespace mapperd::map
