#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/acoustics/scatter.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

constexpr int kSide = 48;  // rays a side: a cell is one column wide, as a fan's are
constexpr double kHalf = 0.12;
constexpr double kWallM = 5.0;
constexpr double kMu = 0.01;

// A wall square ahead of a sonar at the origin, seen by kSide² rays, into a fan's grid.
struct Wall {
  acoustics::Face face{{-1.0, 0.0, 0.0, -kWallM}, 0.0, 5, 0, -1};
  acoustics::Material material{kMu, 0.0, 0.01, 0.1};
  std::vector<std::int32_t> none;
  std::vector<float> cell, span, gain;
  std::vector<acoustics::Leg> legs{{{0, 0, 0}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1.0}};
  std::vector<std::int32_t> transmit;  // leg of each ray; empty is the first
  std::vector<std::int32_t> receive;
  bool both_ways = false;
  std::vector<float> loss = std::vector<float>(kRows, 1.0F);
  std::vector<float> vertical{1.0F, 1.0F};
  std::vector<float> taps{1.0F, 0.0F};
  static constexpr std::ptrdiff_t kRows = 300;
  static constexpr std::ptrdiff_t kColumns = 80;

  explicit Wall(int side = kSide) {
    const double step = 2.0 * kHalf / side;
    for (int i = 0; i < side * side; ++i) {
      const double s = -kHalf + step * (i / side);
      const double w = -kHalf + step * (i % side);
      for (const double edge : {s, s + step, w, w + step}) {
        cell.push_back(static_cast<float>(edge));
      }
      span.insert(span.end(), {0.1F, 100.0F});
      gain.push_back(1.0F);
      none.push_back(0);
    }
  }

  void lean(double angle_rad) {
    face = {{-std::cos(angle_rad), 0.0, std::sin(angle_rad), -kWallM * std::cos(angle_rad)},
            0.0,
            5,
            0,
            -1};
  }

  acoustics::ScatterInput echoes(std::uint64_t key, std::size_t count) const {
    return {{&face, nullptr, &material},
            {count, none.data(), none.data(), transmit.empty() ? none.data() : transmit.data(),
             receive.empty() ? none.data() : receive.data(), cell.data(), span.data(), gain.data(),
             legs.data(), both_ways},
            {kRows, kColumns, 0.02, -0.2, 0.005, 1.0},
            {loss.data(), vertical.data(), 2, taps.data(), 1, taps.size()},
            {true, false, true, 500.0, 4.0, key}};
  }

  std::vector<float> power(int threads) const {
    std::vector<float> grid(kRows * kColumns, 0.0F);
    acoustics::scatter_power(echoes(1, none.size()), grid.data(), threads);
    return grid;
  }

  std::vector<std::complex<float>> field(std::uint64_t key, int threads) const {
    std::vector<std::complex<float>> grid(kRows * kColumns);
    acoustics::scatter_field(echoes(key, none.size()), grid.data(), threads);
    return grid;
  }
};

// The integral of mu cos²i / R⁴ over the patch of wall: dA = R² dOmega / cos i, R = d / cos i and
// dOmega = ds dw / x, so mu cos³i ds dw / (d² x), where x is ahead. The wall leans by an angle
// about the point ahead of the sonar.
double expected_power(double lean_rad = 0.0) {
  const double distance_m = kWallM * std::cos(lean_rad);
  double sum = 0.0;
  constexpr int kFine = 400;
  constexpr double kStep = 2.0 * kHalf / kFine;
  for (int i = 0; i < kFine; ++i) {
    for (int j = 0; j < kFine; ++j) {
      const double s = -kHalf + kStep * (i + 0.5);
      const double w = -kHalf + kStep * (j + 0.5);
      const double x = std::sqrt(1.0 - s * s - w * w);
      const double cosine = std::cos(lean_rad) * x - std::sin(lean_rad) * w;
      sum += kMu * std::pow(cosine, 3) / (distance_m * distance_m * x) * kStep * kStep;
    }
  }
  return sum;
}

double sum_of(const std::vector<float>& powers) {
  double sum = 0.0;
  for (const float cell : powers) sum += static_cast<double>(cell);
  return sum;
}

double sum_of(const std::vector<std::complex<float>>& field) {
  double sum = 0.0;
  for (const auto& cell : field) sum += static_cast<double>(std::norm(cell));
  return sum;
}

TEST_CASE("the mean power of a wall is Lambert's integral over it, however it leans") {
  for (const double lean_rad : {0.0, 0.4, -0.4, 0.8}) {
    Wall wall;
    wall.lean(lean_rad);
    CHECK(sum_of(wall.power(2)) / expected_power(lean_rad) == near(1.0, 0.01));
  }
}

TEST_CASE("a wall that leans has the field's power too") {
  Wall wall(kSide / 8);
  wall.lean(0.8);
  double sum = 0.0;
  for (std::uint64_t key = 0; key < 100; ++key) sum += sum_of(wall.field(key, 2));
  CHECK(sum / 100 / expected_power(0.8) == near(1.0, 0.03));
}

// The wall lies beyond the last row by the mirror's leg alone, and before it by both legs' mean.
TEST_CASE("the field of a way with a mirror ends with the rows, as its mean power does") {
  Wall wall(kSide / 4);
  wall.legs[0] = {{-2.5, 0.0, 0.0}, {1, 0, 0, 0, -1, 0, 0, 0, 1}, {0, 0, 0}, 1.0};
  wall.legs.push_back({{1.0, 0.0, 0.0}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}, 1.0});
  const std::vector<std::int32_t> second(wall.none.size(), 1);
  wall.receive = second;
  wall.both_ways = true;
  double sum = 0.0;
  for (std::uint64_t key = 0; key < 100; ++key) sum += sum_of(wall.field(key, 2));
  CHECK(sum_of(wall.power(2)) > 0.0);
  CHECK(sum / 100 / sum_of(wall.power(2)) == near(1.0, 0.03));
}

// The image of the sonar in a wall beside it: its row and columns are other ones.
TEST_CASE("both ways at once are the sum of one way and the other") {
  Wall there(kSide / 4);
  there.legs.push_back({{0.3, 0.4, 0.1}, {1, 0, 0, 0, -1, 0, 0, 0, 1}, {0, 0, 0}, -0.7});
  const std::vector<std::int32_t> second(there.none.size(), 1);
  there.receive = second;
  Wall back = there, both = there;
  std::swap(back.receive, back.transmit);
  back.receive.clear();
  back.transmit = second;
  both.both_ways = true;
  for (const int threads : {1, 3}) {
    const auto one = there.field(3, threads), other = back.field(3, threads);
    const auto sum = both.field(3, threads);
    const auto power_one = there.power(threads), power_other = back.power(threads);
    const auto power = both.power(threads);
    double worst = 0.0, worst_power = 0.0;
    for (std::size_t i = 0; i < sum.size(); ++i) {
      worst = std::max(worst, static_cast<double>(std::abs(sum[i] - one[i] - other[i])));
      worst_power = std::max(
          worst_power, static_cast<double>(std::fabs(power[i] - power_one[i] - power_other[i])));
    }
    // Points count from the transmitter: either way rounds phases to some 1e-3 turns.
    CHECK(worst < 3e-4 * std::sqrt(sum_of(sum)));
    CHECK(worst_power < 1e-5 * sum_of(power));
    CHECK(sum_of(one) > 0.3 * sum_of(sum) / 2.0);
    CHECK(one != other);
  }
}

TEST_CASE("what an echo spreads to the columns beside it is lost nowhere") {
  Wall wide;
  wide.taps = {0.1F, 0.2F, 0.3F, 0.4F};
  CHECK(sum_of(wide.power(2)) / sum_of(Wall().power(2)) == near(1.0, 1e-5));
}

// One cell's patch on a plane, the first of a batch.
acoustics::Footprints footprint(const std::vector<double>& plane, const std::vector<float>& cell,
                                const std::vector<float>& span) {
  Wall wall(1);
  std::copy_n(plane.data(), 4, wall.face.plane);
  wall.cell = cell;
  wall.span = span;
  acoustics::Footprints patches;
  CHECK(acoustics::footprints_of(wall.echoes(1, 1), 0, 1, patches) == 1);
  CHECK(patches.count == 1);
  CHECK(patches.exists[0]);
  return patches;
}

TEST_CASE("a floor seen along has a patch that ends where its face does") {
  const std::vector<double> floor{0.0, 0.0, 1.0, -1.0};
  const std::vector<float> to_the_sky{-0.01F, 0.01F, -0.05F, 0.01F};
  const acoustics::Footprints far = footprint(floor, to_the_sky, {0.1F, 100.0F});
  CHECK(far.near_m[0] == near(20.0, 1e-4));
  CHECK((far.far_m[0] > 60.0 && far.far_m[0] < 100.0));
  const acoustics::Footprints face = footprint(floor, to_the_sky, {30.0F, 60.0F});
  CHECK(face.near_m[0] == near(30.0, 1e-9));
  CHECK(face.far_m[0] == near(60.0, 1e-9));
}

TEST_CASE("a cell ends where directions do") {
  const acoustics::Footprints abeam =
      footprint({0.0, 1.0, 0.0, -5.0}, {0.95F, 1.05F, -0.01F, 0.01F}, {0.1F, 100.0F});
  CHECK(abeam.near_m[0] == near(5.0, 1e-3));
  for (std::size_t k = 0; k < 4; ++k) CHECK(abeam.corner_m[1][k][0] == near(-5.0, 1e-6));
}

// Hits of a batch share vectors, and batches end where their hits do.
TEST_CASE("a batch of patches is what its hits are one by one") {
  std::vector<acoustics::Face> faces(3);
  faces[0] = {{-1.0, 0.0, 0.0, -5.0}, 0.0, 5, 0, -1};  // ahead
  faces[1] = {{0.0, 0.0, 1.0, -2.0}, 0.0, 5, 0, -1};   // a floor: seen from above only
  faces[2] = {{0.0, -0.6, 0.8, -3.0}, 0.0, 5, 0, -1};  // leans
  Wall wall(7);
  std::vector<std::int32_t> face;
  for (std::size_t hit = 0; hit < wall.none.size(); ++hit) {
    face.push_back(static_cast<std::int32_t>(hit % 5) - 1 == 3 ? 0 : static_cast<int>(hit % 5) - 1);
  }
  acoustics::ScatterInput echoes = wall.echoes(1, face.size());
  echoes.faces.table = faces.data();
  echoes.hits.face = face.data();
  acoustics::Footprints batch, single;
  std::size_t taken = 0, existing = 0, batches = 0;
  for (std::size_t next = 0; next < face.size(); ++batches) {
    const std::size_t first = next;
    next = acoustics::footprints_of(echoes, first, face.size(), batch);
    for (std::size_t i = 0; i < batch.count; ++i, ++taken) {
      CHECK(face[batch.hit[i]] >= 0);
      CHECK((batch.hit[i] >= first && batch.hit[i] < next));
      acoustics::footprints_of(echoes, batch.hit[i], batch.hit[i] + 1, single);
      CHECK(single.count == 1);
      CHECK(single.exists[0] == batch.exists[i]);
      existing += batch.exists[i] ? 1 : 0;
      CHECK(single.near_m[0] == batch.near_m[i]);
      CHECK(single.far_m[0] == batch.far_m[i]);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        for (std::size_t k = 0; k < 4; ++k) {
          CHECK(single.corner_m[axis][k][0] == batch.corner_m[axis][k][i]);
        }
      }
    }
    for (std::size_t i = batch.count; i < acoustics::kPatches; ++i) CHECK(!batch.exists[i]);
  }
  CHECK(batches == 2);
  CHECK(taken == static_cast<std::size_t>(
                     std::count_if(face.begin(), face.end(), [](int f) { return f >= 0; })));
  CHECK((existing > taken / 3 && existing < taken));
}

TEST_CASE("a beam counts there and back, and like losses and gains it is one of amplitudes") {
  const Wall whole(kSide / 4);
  Wall beam = whole, lossy = whole, faint = whole, mirrored = whole;
  beam.vertical = {0.5F, 0.5F};
  lossy.loss.assign(Wall::kRows, 0.5F);
  faint.gain.assign(faint.gain.size(), 0.5F);
  mirrored.legs[0].gain = 0.5;  // of the way there, and of the way back
  const auto check_share = [&whole](const Wall& wall, double share) {
    CHECK(sum_of(wall.power(1)) / sum_of(whole.power(1)) == near(share, 1e-5));
    CHECK(sum_of(wall.field(3, 1)) / sum_of(whole.field(3, 1)) == near(share, 1e-5));
  };
  check_share(beam, 1.0 / 16.0);
  check_share(lossy, 1.0 / 4.0);
  check_share(faint, 1.0 / 4.0);
  check_share(mirrored, 1.0 / 16.0);
}

TEST_CASE("the field's power is the mean power, over many keys, however wide the rays' cells") {
  constexpr int kKeys = 100;
  for (const int side : {kSide, kSide / 2, kSide / 4, kSide / 8}) {
    if (kSanitized && side > kSide / 4) continue;  // the same ways, sixteen times as often
    const Wall wall(side);
    double sum = 0.0;
    for (std::uint64_t key = 0; key < kKeys; ++key) {
      sum += sum_of(wall.field(key, 2));
    }
    CHECK(sum / kKeys / expected_power() == near(1.0, 0.03));
  }
}

TEST_CASE("echoes lie where the wall is and nowhere else") {
  const std::vector<float> grid = Wall().power(1);
  for (std::ptrdiff_t row = 0; row < Wall::kRows; ++row) {
    double sum = 0.0;
    for (std::ptrdiff_t column = 0; column < Wall::kColumns; ++column) {
      sum += static_cast<double>(grid[static_cast<std::size_t>(row * Wall::kColumns + column)]);
    }
    const double far_m = 0.02 * static_cast<double>(row + 1);
    const double corner_m = kWallM / std::sqrt(1.0 - 2.0 * kHalf * kHalf);
    if (far_m < kWallM - 0.02 || far_m > corner_m + 0.06) CHECK(sum == 0.0);
  }
}

TEST_CASE("echoes are the same for any number of threads") {
  const Wall wall;
  const auto power = wall.power(1);
  const auto field = wall.field(9, 1);
  for (const int threads : {2, 3, 8}) {
    CHECK(wall.power(threads) == power);
    CHECK(wall.field(9, threads) == field);
  }
  CHECK(wall.field(10, 2) != field);
}

TEST_CASE("nothing met leaves the grid alone") {
  const Wall wall;
  std::vector<float> power(Wall::kRows * Wall::kColumns, 3.0F);
  std::vector<std::complex<float>> field(Wall::kRows * Wall::kColumns, {3.0F, 4.0F});
  acoustics::scatter_power(wall.echoes(1, 0), power.data(), 2);
  acoustics::scatter_field(wall.echoes(1, 0), field.data(), 2);
  for (const float cell : power) CHECK(cell == 3.0F);
  for (const auto& cell : field) CHECK(cell == std::complex<float>(3.0F, 4.0F));
}

}  // namespace
