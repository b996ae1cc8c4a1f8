// The text in front of an OctoMap tree, and what both directions know about its keys.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace mapperd::map {

inline constexpr int kOctomapDepth = 16;
inline constexpr std::int64_t kOctomapKeyOrigin = 32768;  // the key of voxel 0, on each axis

struct OctomapHeader {
  bool binary = false;      // .bt: two bits a child; else .ot: log-odds
  std::uint64_t nodes = 0;  // as promised, inner ones included
  double resolution_m = 0.0;
  std::size_t data_begin = 0;  // where the text ends
};

// Reads the text in front of a tree. Comments and unknown keywords are skipped, as OctoMap does.
// Throws std::invalid_argument, with the byte where it went wrong.
OctomapHeader parse_octomap_header(std::string_view file);

std::string format_octomap_header(bool binary, std::uint64_t nodes, double resolution_m);

// Throws the std::invalid_argument of all refusals to read: what, and at which byte of the file.
[[noreturn]] void refuse_octomap(std::size_t at, const std::string& what);

}  // namespace mapperd::map
