// Evidence along one beam, a piecewise constant function of range, with the integrals that the
// volume integral over a voxel needs in closed form.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace mapperd::map {

// Two functions at once: f = 1 (`part`) and f = w(I) (`weight`), where there is evidence.
struct Two {
  double part = 0.0;
  double weight = 0.0;
};

// From `near_m` to the next piece's: with C(r) = int_0^r f u^2 du = flux + f r^3 / 3 and
// D(r) = int_0^r C / u^2 du = -flux / r + f r^2 / 6 + offset.
struct RadialPiece {
  double near_m;
  Two value;
  Two flux;
  Two offset;
};

// Pieces in order of range; the last reaches to infinity, before the first all is zero.
class RadialProfile {
 public:
  RadialProfile() = default;
  RadialProfile(const RadialPiece* pieces, std::size_t count, double spacing_m)
      : pieces_(pieces), count_(count), inverse_spacing_(spacing_m > 0 ? 1.0 / spacing_m : 0.0) {}

  bool empty() const { return count_ == 0; }
  std::size_t count() const { return count_; }
  double start_m() const { return pieces_[0].near_m; }
  double end_m() const { return pieces_[count_ - 1].near_m; }
  const RadialPiece& piece(std::size_t i) const { return pieces_[i]; }

  // The piece that holds r >= start_m(); pieces are about `spacing_m` long.
  std::size_t index_at(double r) const {
    const double guess = (r - start_m()) * inverse_spacing_;
    auto i = std::min(static_cast<std::size_t>(guess), count_ - 1);
    while (i > 0 && pieces_[i].near_m > r) --i;
    while (i + 1 < count_ && pieces_[i + 1].near_m <= r) ++i;
    return i;
  }

  // D(r).
  Two potential(double r) const;

 private:
  const RadialPiece* pieces_ = nullptr;
  std::size_t count_ = 0;
  double inverse_spacing_ = 0.0;
};

// Builds a profile piece by piece, in order of range.
class RadialBuilder {
 public:
  explicit RadialBuilder(std::vector<RadialPiece>& pieces) : pieces_(pieces) {}

  void add(double near_m, const Two& value);

 private:
  std::vector<RadialPiece>& pieces_;
  bool first_ = true;
};

}  // namespace mapperd::map
