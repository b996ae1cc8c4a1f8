// The loop that every contender runs, and the JSON that it prints; tools/bench/results.py reads it.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>
#include <vector>

#include "rays_file.hpp"

inline constexpr std::size_t kCountEvery = 5;  // counting costs as much as inserting

// Log-odds of one observation and their clamps: our rule's, whose steps fall with observations.
inline constexpr float kHit = 3.5F;
inline constexpr float kMiss = -3.0F;
inline constexpr float kMin = -10.0F;
inline constexpr float kMax = 10.0F;

struct Contender {
  std::function<void(const RayPing&)> insert;
  std::function<std::size_t(const RayPing&)> count_touched;  // distinct voxels; not timed
  std::function<std::size_t()> memory_bytes;
  std::function<std::size_t()> known_voxels;
};

// A line of /proc/self/status, such as VmHWM, in bytes.
inline std::size_t status_bytes(const std::string& name) {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    std::size_t kib = 0;
    if (word == name + ":" && status >> kib) return kib * 1024;
  }
  return 0;
}

// Milliseconds of each of the first `count` pings; begins none after `budget_ms`, so that a slow
// contender does not hold up the others. Calls `after(i)` after each, untimed.
template <typename After>
std::vector<double> timed_pass(const Contender& contender, const std::vector<RayPing>& pings,
                               std::size_t count, double budget_ms, const After& after) {
  std::vector<double> times_ms;
  double sum_ms = 0;
  for (std::size_t i = 0; i < count && sum_ms < budget_ms; ++i) {
    const auto began = std::chrono::steady_clock::now();
    contender.insert(pings[i]);
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - began;
    times_ms.push_back(took.count());
    sum_ms += took.count();
    after(i);
  }
  return times_ms;
}

inline std::string json_list(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) text += (text.empty() ? "" : ", ") + std::to_string(value);
  return "[" + text + "]";
}

inline void run(const Contender& contender, const std::vector<RayPing>& pings, double budget_ms) {
  const std::size_t start_rss = status_bytes("VmRSS");
  std::string touched;
  const auto count = [&](std::size_t i) {
    touched += i == 0 ? "" : ", ";
    touched += i % kCountEvery == 0 ? std::to_string(contender.count_touched(pings[i])) : "null";
  };
  const auto first_ms = timed_pass(contender, pings, pings.size(), budget_ms, count);
  const std::size_t peak_rss = status_bytes("VmHWM");
  const std::size_t memory = contender.memory_bytes();
  const std::size_t known = contender.known_voxels();
  const auto second_ms =
      timed_pass(contender, pings, first_ms.size(), budget_ms, [](std::size_t /*i*/) {});
  std::cout << "{\"ms\": " << json_list(first_ms) << ", \"second_ms\": " << json_list(second_ms)
            << ", \"touched\": [" << touched << "], \"memory_bytes\": " << memory
            << ", \"known_voxels\": " << known << ", \"start_rss_bytes\": " << start_rss
            << ", \"peak_rss_bytes\": " << peak_rss << "}\n";
}

// The arguments of a contender: RAYS_FILE RESOLUTION_M BUDGET_S [WAY], where `ways` lists the
// allowed ones; empty if there is but one. Calls measure(rays, resolution_m, budget_ms, way).
template <typename Measure>
int contender_main(int argc, char** argv, const std::vector<std::string>& ways,
                   const Measure& measure) {
  const int wanted = ways.empty() ? 4 : 5;
  const std::string way = argc == 5 ? argv[4] : "";
  const bool known_way = ways.empty() || std::find(ways.begin(), ways.end(), way) != ways.end();
  if (argc != wanted || !known_way) {
    std::cerr << "usage: " << argv[0] << " RAYS_FILE RESOLUTION_M BUDGET_S";
    for (std::size_t i = 0; i < ways.size(); ++i) std::cerr << (i == 0 ? " " : "|") << ways[i];
    std::cerr << "\n";
    return 2;
  }
  try {
    measure(std::string(argv[1]), std::atof(argv[2]), 1e3 * std::atof(argv[3]), way);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return 0;
}
