// The loop that every rival runs, and the JSON that it leaves; tools/bench/measured.py reads it.
#pragma once

#include <chrono>
#include <cstddef>
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

struct Rival {
  std::function<void(const RayPing&)> insert;
  std::function<std::size_t(const RayPing&)> count_touched;  // distinct voxels; not timed
  std::function<void()> finish;                              // once, after the last ping
  std::function<std::size_t()> memory_bytes;
  std::function<std::size_t()> known_voxels;
};

inline double ms_of(const std::function<void()>& work) {
  const auto began = std::chrono::steady_clock::now();
  work();
  const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - began;
  return took.count();
}

// A line of /proc/self/status, such as VmHWM, in bytes.
inline std::size_t status_bytes(const std::string& name) {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    std::size_t kib = 0;
    if (word == name + ":" && status >> kib) return kib * 1024;
  }
  return 0;
}

// Stops when `budget_ms` are used up, so that a slow rival does not hold up the others.
inline void run(const Rival& rival, const std::vector<RayPing>& pings, double budget_ms) {
  const std::size_t start_rss = status_bytes("VmRSS");
  std::string times;
  std::string touched;
  double sum_ms = 0;
  for (std::size_t i = 0; i < pings.size() && sum_ms < budget_ms; ++i) {
    const double ms = ms_of([&] { rival.insert(pings[i]); });
    sum_ms += ms;
    times += (i == 0 ? "" : ", ") + std::to_string(ms);
    touched += i == 0 ? "" : ", ";
    touched += i % kCountEvery == 0 ? std::to_string(rival.count_touched(pings[i])) : "null";
  }
  const std::size_t peak_rss = status_bytes("VmHWM");
  const std::size_t memory = rival.memory_bytes();
  const std::size_t known = rival.known_voxels();
  const double finish_ms = ms_of(rival.finish);
  std::cout << "{\"ms\": [" << times << "], \"touched\": [" << touched
            << "], \"memory_bytes\": " << memory << ", \"known_voxels\": " << known
            << ", \"start_rss_bytes\": " << start_rss << ", \"peak_rss_bytes\": " << peak_rss
            << ", \"finish_ms\": " << finish_ms << "}\n";
}

inline constexpr const char* kUsage = "usage: RIVAL rays.bin RESOLUTION_M BUDGET_S";
