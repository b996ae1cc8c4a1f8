#include "mapperd/map/octomap_tree.hpp"

#include <cmath>
#include <cstring>
#include <string>

namespace mapperd::map {
namespace {

class TreeReader {
 public:
  TreeReader(std::string_view file, const OctomapHeader& header, const OctomapVisit& visit)
      : file_(file), at_(header.data_begin), header_(header), visit_(visit) {}

  void read() {
    // An empty tree has no root record.
    if (header_.nodes != 0) read_root();
    if (at_ != file_.size()) {
      refuse_octomap(at_, std::to_string(file_.size() - at_) + " bytes follow the end of the tree");
    }
    if (nodes_ != header_.nodes) {
      refuse_octomap(at_, "the tree has " + std::to_string(nodes_) + " nodes, its header states " +
                              std::to_string(header_.nodes));
    }
  }

 private:
  void read_root() {
    nodes_ = 1;
    if (header_.binary) {
      read_bt({});
    } else {
      read_ot({});
    }
  }

  void read_bt(const OctomapCube& cube) {
    const std::size_t record = at_;
    const char* bytes = take(2);
    const unsigned bits = byte(bytes[0]) | byte(bytes[1]) << 8U;
    // OctoMap would take such a node for a leaf, and a root without children for all of space.
    if (bits == 0) refuse_octomap(record, "an inner node without children");
    for (unsigned i = 0; i < 8; ++i) {
      const unsigned child = bits >> (2 * i) & 3U;
      if (child == 0) continue;
      ++nodes_;
      if (child == 3) {
        check_depth(record, cube.depth + 1);
        read_bt(cube.child(i));
      } else {
        visit_(record, cube.child(i), child == 2 ? occupied_ : free_);
      }
    }
  }

  void read_ot(const OctomapCube& cube) {
    const std::size_t record = at_;
    const char* bytes = take(5);
    std::uint32_t bits = 0;
    for (unsigned i = 0; i < 4; ++i) bits |= byte(bytes[i]) << (8 * i);
    float log_odds = 0.0F;
    std::memcpy(&log_odds, &bits, sizeof log_odds);
    if (std::isnan(log_odds)) refuse_octomap(record, "a node's log-odds are not a number");
    const unsigned mask = byte(bytes[4]);
    if (mask == 0) {
      visit_(record, cube, static_cast<double>(log_odds));
      return;
    }
    check_depth(record, cube.depth);
    for (unsigned i = 0; i < 8; ++i) {
      if ((mask >> i & 1U) == 0) continue;
      ++nodes_;
      read_ot(cube.child(i));
    }
  }

  static std::uint32_t byte(char c) { return static_cast<unsigned char>(c); }

  // An inner node has children, so it is above the finest level.
  static void check_depth(std::size_t record, int depth) {
    if (depth >= kOctomapDepth) refuse_octomap(record, "the tree is deeper than 16 levels");
  }

  const char* take(std::size_t bytes) {
    if (file_.size() - at_ < bytes) refuse_octomap(at_, "the file ends inside the tree");
    at_ += bytes;
    return file_.data() + (at_ - bytes);
  }

  std::string_view file_;
  std::size_t at_;
  const OctomapHeader& header_;
  const OctomapVisit& visit_;
  std::uint64_t nodes_ = 0;
  const double free_ = octomap_free_log_odds();
  const double occupied_ = octomap_occupied_log_odds();
};

}  // namespace

// The probabilities are those of OctoMap's source, where its comments state -2 and 3.5.
double octomap_free_log_odds() { return std::log(0.1192 / (1 - 0.1192)); }
double octomap_occupied_log_odds() { return std::log(0.971 / (1 - 0.971)); }

void for_each_octomap_leaf(std::string_view file, const OctomapHeader& header,
                           const OctomapVisit& visit) {
  TreeReader(file, header, visit).read();
}

}  // namespace mapperd::map
