/// \file
/// \brief The text header of an OctoMap tree, and constants of its keys.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace mapperd::map {

inline constexpr int kOctomapDepth = 16;
inline constexpr std::int64_t kOctomapKeyOrigin = 32768;  ///< the key of voxel 0, on each axis

/// What the text at the beginning of an OctoMap file states.
struct OctomapHeader {
  bool binary = false;         ///< .bt: two bits a child; else .ot: log-odds
  std::uint64_t nodes = 0;     ///< as stated, inner ones included
  double resolution_m = 0.0;   ///< edge of a voxel, m
  std::size_t data_begin = 0;  ///< where the text ends
};

/// Reads the text in front of a tree. Comments and unknown keywords are skipped, as OctoMap does.
/// \throws std::invalid_argument, with the byte of the error.
OctomapHeader parse_octomap_header(std::string_view file);

std::string format_octomap_header(bool binary, std::uint64_t nodes, double resolution_m);

/// Throws std::invalid_argument with an error and the byte of the file where it is.
[[noreturn]] void refuse_octomap(std::size_t at, const std::string& what);

}  // namespace mapperd::map
