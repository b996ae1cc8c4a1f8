// The benchmark's pings as rays; tools/bench/inputs.py writes them and documents the layout.
#pragma once

#include <array>
#include <cstdint>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

struct RayPing {
  std::array<double, 3> origin_m{};          // of the sonar, map frame
  std::vector<std::array<float, 3>> ends_m;  // map frame
};

template <typename Value>
Value read_value(std::ifstream& file) {
  Value value{};
  file.read(reinterpret_cast<char*>(&value), sizeof value);
  return value;
}

// Throws std::runtime_error for a file that is not whole.
inline std::vector<RayPing> read_rays(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const auto magic = read_value<std::array<char, 8>>(file);
  if (std::string(magic.data(), magic.size()) != std::string("mprays1\0", 8)) {
    throw std::runtime_error(path + " holds no rays");
  }
  std::vector<RayPing> pings(read_value<std::uint32_t>(file));
  for (RayPing& ping : pings) {
    ping.origin_m = read_value<std::array<double, 3>>(file);
    ping.ends_m.resize(read_value<std::uint32_t>(file));
    const auto bytes = ping.ends_m.size() * sizeof ping.ends_m[0];
    file.read(reinterpret_cast<char*>(ping.ends_m.data()), static_cast<std::streamsize>(bytes));
  }
  if (!file) throw std::runtime_error(path + " is cut short");
  return pings;
}
