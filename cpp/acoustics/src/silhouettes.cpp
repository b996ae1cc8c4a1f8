#include "mapperd/acoustics/silhouettes.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace mapperd::acoustics {

namespace {

constexpr double kPiece = 0.005;  // rad, to which a straight edge is a straight line of s and w
constexpr double kMinCut = 2e-5;  // of s and w: cuts closer than that are one
constexpr std::size_t kMaxSlabs = 16;   // of a cell
constexpr std::size_t kMaxParts = 400;  // of a cell, about
constexpr double kHiddenFactor = 1.02;
constexpr double kHiddenM = 0.02;    // so far behind all that was met about it, an edge is hidden
constexpr std::size_t kBetween = 8;  // rays between two that met different surfaces
constexpr std::size_t kPairShare = 32;  // at most one pair to so many rays
constexpr double kRimPart = 1.0 - 1e-5;

// A piece of an outline within one cell.
struct Segment {
  std::int32_t cell;
  float s[2], w[2];
  float face_side;  // sign: on which side of the way from the first end the face is; 0: on both
  bool outline;     // otherwise a crease of what is seen
  bool round;
};

// The other way round: w for s.
Segment transposed(const Segment& segment) {
  Segment other = segment;
  std::copy_n(segment.s, 2, other.w);
  std::copy_n(segment.w, 2, other.s);
  other.face_side = -segment.face_side;
  return other;
}

struct SinePoint {
  double s, w, range_m;
};

SinePoint sine_point(const Vec3& p) {
  const double range_m = std::sqrt(std::max(dot(p, p), 1e-18));
  return {-p.y / range_m, p.z / range_m, range_m};
}

// Where a point seems to be by the direction in which the ray to it leaves. A ray's elevation
// changes by -(dc/dz) cos / c along the way (Snell); the chord's is the mean over the way.
Vec3 by_departure(const RefractionView& view, const Vec3& p) {
  constexpr int kSteps = 8;
  const double range_m = norm(p);
  if (view.layers.depth_m.empty() || range_m < 1e-9) return p;
  const double rise = dot(p, view.up) / range_m;
  const double level = std::sqrt(std::max(1.0 - rise * rise, 1e-12));
  double turn = 0.0;
  for (int k = 0; k < kSteps; ++k) {
    const double part = (k + 0.5) / kSteps;
    double speed_mps = 0.0;
    const double gradient =
        speed_gradient(view.layers, -(view.height_m + part * range_m * rise), speed_mps);
    turn -= (1.0 - part) * gradient * level / speed_mps * range_m / kSteps;
  }
  const Vec3 upright = (1.0 / level) * (view.up - (rise / range_m) * p);
  return std::cos(turn) * p - (range_m * std::sin(turn)) * upright;
}

// Lays edges into the cells of a grid.
class Rasteriser {
 public:
  Rasteriser(const FanGrid& grid, const FanHits& hits, double reach_m, const RefractionView& view)
      : grid_(grid),
        hits_(hits),
        reach_m_(reach_m),
        view_(view),
        far_m_(grid.columns * grid.rows, -1.0F) {
    const double low = grid.row_edges[0];
    const double wide = (grid.row_edges[grid.rows] - low) / static_cast<double>(kGuesses);
    for (std::size_t i = 0; i < kGuesses; ++i) {
      guess_[i] = row_from(low + wide * static_cast<double>(i), 0);
    }
    per_guess_ = 1.0 / wide;
    set_window();
  }

  void add(const SeenMesh& mesh) {
    const auto o =
        std::array<float, 3>{static_cast<float>(mesh.sonar_m.x), static_cast<float>(mesh.sonar_m.y),
                             static_cast<float>(mesh.sonar_m.z)};
    for (const EdgeBlock& block : mesh.mesh->blocks) {
      if (!may_show(block, o) || !in_window(mesh, block)) continue;
      for (std::size_t i = block.first; i < block.last; ++i) {
        const MeshEdge& edge = mesh.mesh->edges[i];
        const bool outline = edge.border || front(edge.plane[0], o) != front(edge.plane[1], o);
        if (outline || edge.crease) add_edge(mesh, edge, outline);
      }
    }
  }

  std::vector<Segment> take() { return std::move(segments_); }

 private:
  static bool front(const float* plane, const std::array<float, 3>& from) {
    return plane[0] * from[0] + plane[1] * from[1] + plane[2] * from[2] > plane[3];
  }

  // False where all faces of a block show the same side, or are out of reach.
  [[nodiscard]] bool may_show(const EdgeBlock& block, const std::array<float, 3>& from) const {
    float squares = 0.0F, along = 0.0F;
    for (std::size_t k = 0; k < 3; ++k) {
      const float away = from[k] - block.centre_m[k];
      squares += away * away;
      along += away * block.axis[k];
    }
    const float range_m = std::sqrt(squares);
    if (range_m > static_cast<float>(reach_m_) + block.radius_m) return false;
    if (!block.smooth || block.cosine <= 0.0F) return true;
    // The cosine between a normal and the way to the sonar is at least that of the sum of angles.
    const float cosine = std::fabs(along);
    const float sine = std::sqrt(std::max(squares - along * along, 0.0F));
    const float cone_sine = std::sqrt(std::max(1.0F - block.cosine * block.cosine, 0.0F));
    return cosine * block.cosine - sine * cone_sine <= block.radius_m;
  }

  // The directions between the outermost cells that have rays.
  void set_window() {
    std::size_t first_column = grid_.columns, last_column = 0;
    std::size_t first_row = grid_.rows, last_row = 0;
    for (std::size_t column = 0, cell = 0; column < grid_.columns; ++column) {
      for (std::size_t row = 0; row < grid_.rows; ++row, ++cell) {
        if (grid_.rays[cell] < 0) continue;
        first_column = std::min(first_column, column);
        last_column = column;
        first_row = std::min(first_row, row);
        last_row = std::max(last_row, row);
      }
    }
    if (first_column == grid_.columns) return;
    low_column_ = static_cast<double>(first_column);
    high_column_ = static_cast<double>(last_column + 1);
    low_w_ = grid_.row_edges[first_row];
    high_w_ = grid_.row_edges[last_row + 1];
  }

  // False if no point of a block is in the window. Sines of directions change by no more than the
  // angle between them. Where layers bend rays, all blocks are looked at.
  [[nodiscard]] bool in_window(const SeenMesh& mesh, const EdgeBlock& block) const {
    if (!view_.layers.depth_m.empty()) return true;
    const Vec3 middle = seen(mesh, block.centre_m);
    const auto radius_m = static_cast<double>(block.radius_m) * 1.001;
    const double range_m = norm(middle);
    if (range_m <= radius_m) return true;
    if (middle.x < -radius_m) return false;
    constexpr double kHalfPi = 1.5707963267948966;
    const double off = std::min(kHalfPi * radius_m / range_m, 2.0);  // at least the arc sine
    const double column = column_of(-middle.y / range_m), w = middle.z / range_m;
    const double columns = off / grid_.s_pitch;
    return column + columns >= low_column_ && column - columns <= high_column_ &&
           w + off >= low_w_ && w - off <= high_w_;
  }

  static Vec3 seen(const SeenMesh& mesh, const float* point_m) {
    const auto& m = mesh.rotation;
    const double x = static_cast<double>(point_m[0]), y = static_cast<double>(point_m[1]);
    const double z = static_cast<double>(point_m[2]);
    return mesh.origin_m + Vec3{m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z,
                                m[6] * x + m[7] * y + m[8] * z};
  }

  void add_edge(const SeenMesh& mesh, const MeshEdge& edge, bool outline) {
    Vec3 a = seen(mesh, edge.end_m[0]);
    Vec3 b = seen(mesh, edge.end_m[1]);
    if (a.x <= 0.0 && b.x <= 0.0) return;
    // What lies behind the sonar is cut off.
    if (a.x < 0.0) a = a + (a.x / (a.x - b.x)) * (b - a);
    if (b.x < 0.0) b = b + (b.x / (b.x - a.x)) * (a - b);
    const Vec3 way = b - a;
    const double length2 = dot(way, way);
    const double nearest = std::clamp(-dot(a, way) / std::max(length2, 1e-18), 0.0, 1.0);
    const Vec3 near = a + nearest * way;
    const double near_m = std::sqrt(dot(near, near));
    if (!(near_m <= reach_m_) || near_m < 1e-6) return;
    proto_.outline = outline;
    proto_.round = outline && edge.round;
    proto_.face_side = outline ? side_of_face(a, b, seen(mesh, edge.inner_m)) : 0.0F;
    const double angle = std::sqrt(length2) / near_m;
    const auto pieces = static_cast<std::size_t>(std::clamp(angle / kPiece, 0.0, 4000.0)) + 1;
    SinePoint from = sine_point(by_departure(view_, a));
    for (std::size_t k = 1; k <= pieces; ++k) {
      const double part = static_cast<double>(k) / static_cast<double>(pieces);
      const SinePoint to = sine_point(by_departure(view_, k == pieces ? b : a + part * way));
      add_piece(from, to);
      from = to;
    }
  }

  // Sign of the triangle a, b, c in s and w.
  static float side_of_face(const Vec3& a, const Vec3& b, const Vec3& c) {
    // Of the plane through the origin, a and b: its normal's side does not depend on ranges.
    const double side = dot(cross(a, b), c);
    return side > 0.0 ? -1.0F : 1.0F;
  }

  [[nodiscard]] std::size_t row_from(double w, std::size_t row) const {
    while (row + 1 < grid_.rows && w >= grid_.row_edges[row + 1]) ++row;
    return row;
  }

  [[nodiscard]] std::size_t row_of(double w) const {
    const double at = (w - grid_.row_edges[0]) * per_guess_;
    if (at <= 0.0) return 0;
    const auto guess = std::min(static_cast<std::size_t>(at), kGuesses - 1);
    return row_from(w, guess_[guess]);
  }

  [[nodiscard]] double column_of(double s) const { return (s - grid_.first_s) / grid_.s_pitch; }

  void add_piece(const SinePoint& a, const SinePoint& b) {
    const double c0 = column_of(a.s), c1 = column_of(b.s);
    if ((a.w < low_w_ && b.w < low_w_) || (a.w >= high_w_ && b.w >= high_w_) ||
        (c0 < low_column_ && c1 < low_column_) || (c0 >= high_column_ && c1 >= high_column_)) {
      return;
    }
    // Cut by rows, then by columns; parameters run from a to b.
    const std::size_t row0 = row_of(std::min(a.w, b.w)), row1 = row_of(std::max(a.w, b.w));
    for (std::size_t row = row0; row <= row1; ++row) {
      double t0 = 0.0, t1 = 1.0;
      if (!clip(a.w, b.w, grid_.row_edges[row], grid_.row_edges[row + 1], t0, t1)) continue;
      const double d0 = c0 + t0 * (c1 - c0), d1 = c0 + t1 * (c1 - c0);
      const double first = std::max(std::floor(std::min(d0, d1)), low_column_);
      const double last = std::min(std::floor(std::max(d0, d1)), high_column_ - 1.0);
      for (double column = first; column <= last; column += 1.0) {
        double u0 = t0, u1 = t1;
        if (!clip(c0, c1, column, column + 1.0, u0, u1)) continue;
        add_segment(a, b, u0, u1, static_cast<std::size_t>(column), row);
      }
    }
  }

  // Parameters between which a line from a to b is from low to high.
  static bool clip(double a, double b, double low, double high, double& t0, double& t1) {
    const double step = b - a;
    if (std::fabs(step) < 1e-15) return a >= low && a < high;
    const double enter = ((step > 0.0 ? low : high) - a) / step;
    const double leave = ((step > 0.0 ? high : low) - a) / step;
    t0 = std::max(t0, enter);
    t1 = std::min(t1, leave);
    return t0 < t1;
  }

  void add_segment(const SinePoint& a, const SinePoint& b, double t0, double t1, std::size_t column,
                   std::size_t row) {
    const std::size_t cell = column * grid_.rows + row;
    if (grid_.rays[cell] < 0) return;
    const double range_m = std::min(a.range_m + t0 * (b.range_m - a.range_m),
                                    a.range_m + t1 * (b.range_m - a.range_m));
    if (range_m > reach_m_ || range_m > far_about(column, row)) return;
    Segment segment = proto_;
    segment.cell = static_cast<std::int32_t>(cell);
    segment.s[0] = static_cast<float>(a.s + t0 * (b.s - a.s));
    segment.s[1] = static_cast<float>(a.s + t1 * (b.s - a.s));
    segment.w[0] = static_cast<float>(a.w + t0 * (b.w - a.w));
    segment.w[1] = static_cast<float>(a.w + t1 * (b.w - a.w));
    segments_.push_back(segment);
  }

  // Beyond it all is hidden by what the rays in and beside a cell met.
  double far_about(std::size_t column, std::size_t row) {
    float& far_m = far_m_[column * grid_.rows + row];
    if (far_m < 0.0F) {
      far_m = 0.0F;
      for (std::size_t c = column - (column > 0); c <= column + 1 && c < grid_.columns; ++c) {
        for (std::size_t r = row - (row > 0); r <= row + 1 && r < grid_.rows; ++r) {
          const std::int32_t ray = grid_.rays[c * grid_.rows + r];
          if (ray >= 0) far_m = std::max(far_m, hits_.range_m[ray]);
        }
      }
    }
    return kHiddenFactor * static_cast<double>(far_m) + kHiddenM;
  }

  static constexpr std::size_t kGuesses = 512;

  const FanGrid& grid_;
  const FanHits& hits_;
  double reach_m_;
  const RefractionView& view_;
  std::vector<float> far_m_;  // farthest hit in and about each cell; negative: not known yet
  std::array<std::size_t, kGuesses> guess_{};
  double per_guess_ = 0.0;
  double low_column_ = 0.0, high_column_ = 0.0, low_w_ = 0.0, high_w_ = 0.0;  // see `set_window`
  Segment proto_{};
  std::vector<Segment> segments_;
};

// Where a slab's middle crosses an outline.
struct Cut {
  double at, lean;  // in s; its growth with w
  bool face_below, face_above, round;
};

struct Box {
  double s0, s1, w0, w1;
  double s_per_w = 0.0, w_per_s = 0.0;  // see `RefinedRays::lean`
};

// Cuts cells into parts of one surface each: slabs in w between the ends of segments, in them parts
// in s between the segments. A part is a rectangle as large as the trapezium that it stands for;
// between two outlines it leans as they do.
class Cutter {
 public:
  // Boxes that together are the cell.
  const std::vector<Box>& cut(const Box& cell, const Segment* segments, std::size_t count) {
    boxes_.clear();
    find_continued(cell, segments, count);
    ends(cell.w0, cell.w1, segments, count, false, slabs_);
    ends(cell.s0, cell.s1, segments, count, true, others_);
    if (slabs_.size() <= others_.size()) {
      slabs(cell, segments, count);
    } else {
      turned_.resize(count);
      std::transform(segments, segments + count, turned_.begin(), transposed);
      slabs_.swap(others_);
      slabs({cell.w0, cell.w1, cell.s0, cell.s1}, turned_.data(), count);
      for (Box& box : boxes_) box = {box.w0, box.w1, box.s0, box.s1, 0.0, box.s_per_w};
    }
    return boxes_;
  }

 private:
  static bool inside(const Box& cell, const Segment& segment, std::size_t end) {
    const auto s = static_cast<double>(segment.s[end]), w = static_cast<double>(segment.w[end]);
    return (s > cell.s0 + kMinCut && s < cell.s1 - kMinCut) ||
           (w > cell.w0 + kMinCut && w < cell.w1 - kMinCut);
  }

  // Borders of the slabs.
  void ends(double low, double high, const Segment* segments, std::size_t count, bool across,
            std::vector<double>& to) const {
    to.clear();
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t end = 0; end < 2; ++end) {
        const float* along = across ? segments[i].s : segments[i].w;
        const auto at = static_cast<double>(along[end]);
        if (at > low + kMinCut && at < high - kMinCut && goes_on_[2 * i + end] == 0) {
          to.push_back(at);
        }
      }
    }
    std::sort(to.begin(), to.end());
    to.erase(std::unique(to.begin(), to.end(), [](double a, double b) { return b - a < kMinCut; }),
             to.end());
    if (to.size() >= kMaxSlabs) {
      const double first = to.front(), last = to.back();
      to.clear();
      for (std::size_t k = 0; k + 1 < kMaxSlabs; ++k) {
        to.push_back(first + (last - first) * uneven(k, kMaxSlabs - 1));
      }
    }
    to.insert(to.begin(), low);
    to.push_back(high);
  }

  // The k-th of some steps from 0 to 1, all of about one size: no pattern repeats with them.
  static double uneven(std::size_t k, std::size_t steps) {
    constexpr double kGolden = 0.6180339887498949;
    const double shift = std::fmod(static_cast<double>(k) * kGolden, 1.0);
    return (static_cast<double>(k) + shift) / static_cast<double>(steps);
  }

  // Marks the ends from which another segment goes straight on: how finely an edge is divided then
  // changes nothing.
  void find_continued(const Box& cell, const Segment* segments, std::size_t count) {
    by_s_.clear();
    for (std::size_t i = 0; i < 2 * count; ++i) {
      by_s_.emplace_back(segments[i / 2].s[i % 2], static_cast<std::uint32_t>(i));
    }
    std::sort(by_s_.begin(), by_s_.end());
    goes_on_.assign(2 * count, 0);
    for (std::size_t at = 0; at < by_s_.size(); ++at) {
      const std::uint32_t i = by_s_[at].second;
      goes_on_[i] = inside(cell, segments[i / 2], i % 2) && goes_on(segments, at);
    }
  }

  // Whether exactly one other segment begins at an end, and goes straight on.
  [[nodiscard]] bool goes_on(const Segment* segments, std::size_t at) const {
    constexpr float kSame = 1e-6F;
    constexpr float kStraight = 0.01F;  // sine of the angle
    const std::uint32_t i = by_s_[at].second;
    const Segment& one = segments[i / 2];
    const float s = one.s[i % 2], w = one.w[i % 2];
    const float ds = one.s[1 - i % 2] - s, dw = one.w[1 - i % 2] - w;
    std::size_t first = at;
    while (first > 0 && std::fabs(by_s_[first - 1].first - s) <= kSame) --first;
    std::size_t found = 0;
    bool straight = false;
    for (std::size_t k = first; k < by_s_.size(); ++k) {
      if (std::fabs(by_s_[k].first - s) > kSame) break;
      const std::uint32_t j = by_s_[k].second;
      const Segment& other = segments[j / 2];
      if (j / 2 == i / 2 || std::fabs(other.w[j % 2] - w) > kSame) continue;
      const float es = other.s[1 - j % 2] - s, ew = other.w[1 - j % 2] - w;
      const float size = std::sqrt((ds * ds + dw * dw) * (es * es + ew * ew));
      if (++found > 1) return false;
      straight = ds * es + dw * ew < 0.0F && std::fabs(ds * ew - dw * es) < kStraight * size;
    }
    return found == 1 && straight;
  }

  void slabs(const Box& cell, const Segment* segments, std::size_t count) {
    for (std::size_t k = 0; k + 1 < slabs_.size(); ++k) {
      const double w0 = slabs_[k], w1 = slabs_[k + 1];
      cross(cell, 0.5 * (w0 + w1), segments, count);
      parts(cell, w0, w1);
    }
  }

  void cross(const Box& cell, double w, const Segment* segments, std::size_t count) {
    cuts_.clear();
    for (std::size_t i = 0; i < count; ++i) {
      const Segment& g = segments[i];
      const double a = static_cast<double>(g.w[0]), b = static_cast<double>(g.w[1]);
      if ((a <= w) == (b <= w)) continue;
      const double s0 = static_cast<double>(g.s[0]), s1 = static_cast<double>(g.s[1]);
      const float upwards = b > a ? g.face_side : -g.face_side;  // positive: towards smaller s
      const double lean = (s1 - s0) / (b - a);
      cuts_.push_back({s0 + (w - a) * lean, lean, upwards > 0.0F, upwards < 0.0F, g.round});
    }
    std::sort(cuts_.begin(), cuts_.end(), [](const Cut& a, const Cut& b) { return a.at < b.at; });
    // Of too many, as of a net far off, each part shows what its middle meets.
    const std::size_t most = kMaxParts / (slabs_.size() - 1);
    if (cuts_.size() > most) {
      cuts_.clear();
      for (std::size_t k = 0; k < most; ++k) {
        cuts_.push_back(
            {cell.s0 + (cell.s1 - cell.s0) * uneven(k, most), 0.0, false, false, false});
      }
    }
  }

  void parts(const Box& cell, double w0, double w1) {
    double from = cell.s0;
    bool face_above = false, round_before = false;
    for (std::size_t k = 0; k <= cuts_.size(); ++k) {
      const bool last = k == cuts_.size();
      const double to = last ? cell.s1 : std::clamp(cuts_[k].at, from, cell.s1);
      if (to - from > (last ? 0.0 : kMinCut)) {
        // A round surface turns away from its middle to its outline.
        const int round = static_cast<int>(face_above && round_before) +
                          static_cast<int>(!last && cuts_[k].face_below && cuts_[k].round);
        const Box part{from, to, w0, w1};
        add(k == 0 || last ? part : leaning(cell, part, 0.5 * (cuts_[k - 1].lean + cuts_[k].lean)),
            round == 0 ? 1 : 3 * round);
        from = to;
      }
      if (!last) {
        face_above = cuts_[k].face_above;
        round_before = cuts_[k].round;
      }
    }
  }

  // The part, leaning as far as it stays in its cell.
  static Box leaning(const Box& cell, Box part, double lean) {
    const double room = std::max(std::min(part.s0 - cell.s0, cell.s1 - part.s1), 0.0);
    const double most = 2.0 * room / (part.w1 - part.w0);
    part.s_per_w = std::clamp(lean, -most, most);
    return part;
  }

  void add(const Box& whole, int pieces) {
    const double wide = (whole.s1 - whole.s0) / pieces;
    for (int k = 0; k < pieces; ++k) {
      Box piece = whole;
      piece.s0 = whole.s0 + wide * k;
      piece.s1 = whole.s0 + wide * (k + 1);
      boxes_.push_back(piece);
    }
  }

  std::vector<Box> boxes_;
  std::vector<double> slabs_, others_;
  std::vector<Cut> cuts_;
  std::vector<Segment> turned_;
  std::vector<std::pair<float, std::uint32_t>> by_s_;  // ends of segments, two of each
  std::vector<char> goes_on_;                          // of both ends of each segment
};

// Segments cell after cell.
struct Sorted {
  std::vector<Segment> segments;
  std::vector<std::uint32_t> first;  // of each cell, and the end, (cells + 1,)
};

Sorted sorted(const std::vector<Segment>& segments, std::size_t cells) {
  Sorted to;
  to.first.assign(cells + 1, 0);
  for (const Segment& g : segments) ++to.first[static_cast<std::size_t>(g.cell) + 1];
  for (std::size_t i = 0; i < cells; ++i) to.first[i + 1] += to.first[i];
  std::vector<std::uint32_t> next(to.first.begin(), to.first.end() - 1);
  to.segments.resize(segments.size());
  for (const Segment& g : segments) to.segments[next[static_cast<std::size_t>(g.cell)]++] = g;
  return to;
}

bool has_outline(const Segment* first, const Segment* last) {
  return std::any_of(first, last, [](const Segment& g) { return g.outline; });
}

class Refiner {
 public:
  Refiner(const FanHits& hits, RefinedRays& to) : hits_(hits), to_(to) {}

  // Rays from `first` to before `last`.
  void keep(std::size_t first, std::size_t last, const std::int32_t* columns) {
    to_.direction.insert(to_.direction.end(), hits_.direction + 3 * first,
                         hits_.direction + 3 * last);
    to_.cell.insert(to_.cell.end(), hits_.cell + 4 * first, hits_.cell + 4 * last);
    to_.lean.resize(to_.lean.size() + 2 * (last - first), 0.0F);
    to_.column.insert(to_.column.end(), columns + first, columns + last);
    const std::size_t before = to_.from.size();
    to_.from.resize(before + last - first);
    std::iota(to_.from.begin() + static_cast<std::ptrdiff_t>(before), to_.from.end(),
              static_cast<std::int32_t>(first));
  }

  // One ray, of a part of its cell.
  void keep_between(std::size_t ray, std::int32_t column, float w0, float w1) {
    const float* cell = hits_.cell + 4 * ray;
    const float* direction = hits_.direction + 3 * ray;
    to_.direction.insert(to_.direction.end(), direction, direction + 3);
    to_.cell.insert(to_.cell.end(), {cell[0], cell[1], w0, w1});
    to_.lean.insert(to_.lean.end(), {0.0F, 0.0F});
    to_.column.push_back(column);
    to_.from.push_back(static_cast<std::int32_t>(ray));
  }

  void add(const Box& box, std::int32_t column) {
    const double w = 0.5 * (box.w0 + box.w1);
    const double most = std::sqrt(std::max(1.0 - w * w, 0.0)) * kRimPart;
    if (box.s0 >= most || box.s1 <= -most) return;
    const double s = 0.5 * (std::max(box.s0, -most) + std::min(box.s1, most));
    const double ahead = std::sqrt(std::max(1.0 - s * s - w * w, 0.0));
    for (const double axis : {ahead, -s, w}) to_.direction.push_back(static_cast<float>(axis));
    for (const double edge : {box.s0, box.s1, box.w0, box.w1}) {
      to_.cell.push_back(static_cast<float>(edge));
    }
    for (const double lean : {box.s_per_w, box.w_per_s}) {
      to_.lean.push_back(static_cast<float>(lean));
    }
    to_.column.push_back(column);
    to_.from.push_back(-1);
  }

 private:
  const FanHits& hits_;
  RefinedRays& to_;
};

// Of pairs without an outline those farthest apart, as a mark for each ray.
std::vector<char> lower_rays(const FanHits& hits, const std::vector<std::int64_t>& pairs,
                             const std::vector<char>& marked) {
  const auto range = [&hits](std::int64_t ray) { return std::min(hits.range_m[ray], 1e6F); };
  std::vector<std::pair<float, std::int64_t>> left;
  for (const std::int64_t ray : pairs) {
    if (!marked[static_cast<std::size_t>(ray)] && !marked[static_cast<std::size_t>(ray) + 1]) {
      left.emplace_back(-std::fabs(range(ray + 1) - range(ray)), ray);
    }
  }
  const std::size_t most = hits.count / kPairShare;
  if (left.size() > most) {
    std::nth_element(left.begin(), left.begin() + static_cast<std::ptrdiff_t>(most), left.end());
    left.resize(most);
  }
  std::vector<char> lower(hits.count, 0);
  for (const auto& pair : left) lower[static_cast<std::size_t>(pair.second)] = 1;
  return lower;
}

}  // namespace

RefinedRays refined_rays(const FanGrid& grid, const FanHits& hits,
                         const std::vector<SeenMesh>& meshes,
                         const std::vector<std::int64_t>& pairs, double reach_m,
                         const RefractionView& view) {
  Rasteriser rasteriser(grid, hits, reach_m, view);
  for (const SeenMesh& mesh : meshes) rasteriser.add(mesh);
  const std::size_t cells = grid.columns * grid.rows;
  const Sorted outlines = sorted(rasteriser.take(), cells);
  const Segment* segments = outlines.segments.data();
  std::vector<char> marked(hits.count, 0);
  std::vector<std::size_t> cell_of(hits.count, 0);
  std::vector<std::int32_t> column_of(hits.count, 0);
  for (std::size_t column = 0, cell = 0; column < grid.columns; ++column) {
    for (std::size_t row = 0; row < grid.rows; ++row, ++cell) {
      if (grid.rays[cell] < 0) continue;
      const auto ray = static_cast<std::size_t>(grid.rays[cell]);
      cell_of[ray] = cell;
      column_of[ray] = static_cast<std::int32_t>(column);
      marked[ray] =
          has_outline(segments + outlines.first[cell], segments + outlines.first[cell + 1]);
    }
  }
  const std::vector<char> lower = lower_rays(hits, pairs, marked);
  RefinedRays to;
  const std::size_t about = hits.count + hits.count / 2;
  to.direction.reserve(3 * about);
  to.cell.reserve(4 * about);
  to.lean.reserve(2 * about);
  to.column.reserve(about);
  to.from.reserve(about);
  Refiner refiner(hits, to);
  Cutter cutter;
  std::size_t kept = 0;  // rays before it are done
  for (std::size_t ray = 0; ray < hits.count; ++ray) {
    const bool below = lower[ray] != 0, above = ray > 0 && lower[ray - 1] != 0;
    if (!(marked[ray] || below || above)) continue;
    refiner.keep(kept, ray, column_of.data());
    kept = ray + 1;
    const std::int32_t column = column_of[ray];
    const float* edges = hits.cell + 4 * ray;
    if (marked[ray]) {
      const Box box{static_cast<double>(edges[0]), static_cast<double>(edges[1]),
                    static_cast<double>(edges[2]), static_cast<double>(edges[3])};
      const std::uint32_t first = outlines.first[cell_of[ray]];
      const std::uint32_t last = outlines.first[cell_of[ray] + 1];
      for (const Box& part : cutter.cut(box, segments + first, last - first)) {
        refiner.add(part, column);
      }
      continue;
    }
    // Cells beside rays that are laid between them end at their own rays.
    const float own_w = hits.direction[3 * ray + 2];
    if (!above || !below) {
      refiner.keep_between(ray, column, above ? own_w : edges[2], below ? own_w : edges[3]);
    }
    if (below) {
      const double w0 = static_cast<double>(own_w);
      const double step = (static_cast<double>(hits.direction[3 * (ray + 1) + 2]) - w0) / kBetween;
      for (std::size_t k = 0; k < kBetween; ++k) {
        const double low = w0 + step * static_cast<double>(k);
        refiner.add({static_cast<double>(edges[0]), static_cast<double>(edges[1]), low, low + step},
                    column);
      }
    }
  }
  refiner.keep(kept, hits.count, column_of.data());
  return to;
}

}  // namespace mapperd::acoustics
