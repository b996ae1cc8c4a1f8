#include "mapperd/map/octomap_header.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <locale>
#include <sstream>
#include <stdexcept>

namespace mapperd::map {
namespace {

constexpr std::string_view kBinaryMagic = "# Octomap OcTree binary file";
constexpr std::string_view kFullMagic = "# Octomap OcTree file";
// Trees of 2010 and before begin with the integer 3 instead of text.
constexpr std::string_view kLegacyMagic{"\x03\x00\x00\x00", 4};

bool starts_with(std::string_view text, std::string_view prefix) {
  return text.substr(0, prefix.size()) == prefix;
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\r";
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

// What a stranger wrote, fit to be shown: short and printable.
std::string quoted(std::string_view text) {
  std::string shown(text.substr(0, 40));
  for (char& c : shown) {
    if (c < ' ' || c > '~') c = '?';
  }
  return "'" + shown + (text.size() > 40 ? "...'" : "'");
}

bool magic_of(std::string_view file) {
  if (starts_with(file, kBinaryMagic)) return true;
  if (starts_with(file, kFullMagic)) return false;
  if (starts_with(file, kLegacyMagic)) {
    refuse_octomap(0, "a binary tree of OctoMap before 1.0; convert_octree makes a new one of it");
  }
  refuse_octomap(0, "no OctoMap tree: the first line is neither " + quoted(kBinaryMagic) + " nor " +
                        quoted(kFullMagic));
}

std::uint64_t nodes_of(std::size_t at, std::string_view value) {
  std::uint64_t nodes = 0;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), nodes);
  if (error != std::errc{} || end != value.data() + value.size()) {
    refuse_octomap(at, "size must be a number of nodes, not " + quoted(value));
  }
  return nodes;
}

double resolution_of(std::size_t at, std::string_view value) {
  std::istringstream text{std::string(value)};
  text.imbue(std::locale::classic());
  double resolution_m = 0.0;
  const bool read = text >> resolution_m && text.peek() == std::istringstream::traits_type::eof();
  if (!read || !std::isfinite(resolution_m) || resolution_m <= 0.0) {
    refuse_octomap(at, "res must be a positive number of metres, not " + quoted(value));
  }
  return resolution_m;
}

void check_id(std::size_t at, std::string_view id) {
  // "1" is what OctoMap wrote before its trees had names; OctoMap itself still takes it.
  if (id == "OcTree" || id == "1") return;
  refuse_octomap(at, "a tree of type " + quoted(id) + "; only OcTree can be read");
}

// The fields that must be there, and once.
struct RequiredFields {
  bool id = false;
  bool size = false;
  bool res = false;
};

void first_time(std::size_t at, bool& seen, const char* keyword) {
  if (seen) refuse_octomap(at, std::string(keyword) + " is given twice");
  seen = true;
}

void parse_field(std::size_t at, std::string_view line, RequiredFields& seen,
                 OctomapHeader& header) {
  const std::string_view keyword = line.substr(0, line.find_first_of(" \t"));
  const std::string_view value = trimmed(line.substr(keyword.size()));
  if (keyword == "id") {
    first_time(at, seen.id, "id");
    check_id(at, value);
  } else if (keyword == "size") {
    first_time(at, seen.size, "size");
    header.nodes = nodes_of(at, value);
  } else if (keyword == "res") {
    first_time(at, seen.res, "res");
    header.resolution_m = resolution_of(at, value);
  }
}

}  // namespace

void refuse_octomap(std::size_t at, const std::string& what) {
  throw std::invalid_argument("OctoMap file, byte " + std::to_string(at) + ": " + what);
}

OctomapHeader parse_octomap_header(std::string_view file) {
  OctomapHeader header;
  header.binary = magic_of(file);
  RequiredFields seen;
  std::size_t at = 0;
  while (true) {
    const std::size_t end = file.find('\n', at);
    if (end == std::string_view::npos) refuse_octomap(at, "the header has no line 'data'");
    const std::string_view line = trimmed(file.substr(at, end - at));
    if (line == "data") {
      if (!seen.id) refuse_octomap(at, "the header has no line 'id'");
      if (!seen.size) refuse_octomap(at, "the header has no line 'size'");
      if (!seen.res) refuse_octomap(at, "the header has no line 'res'");
      header.data_begin = end + 1;
      return header;
    }
    if (!starts_with(line, "#")) parse_field(at, line, seen, header);
    at = end + 1;
  }
}

std::string format_octomap_header(bool binary, std::uint64_t nodes, double resolution_m) {
  std::ostringstream header;
  header.imbue(std::locale::classic());
  header.precision(17);
  header << (binary ? kBinaryMagic : kFullMagic) << "\n# Written by mapperd\nid OcTree\nsize "
         << nodes << "\nres " << resolution_m << "\ndata\n";
  return header.str();
}

}  // namespace mapperd::map
