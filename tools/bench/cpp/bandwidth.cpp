// Streaming read-modify-write of one thread over a buffer that no cache holds: bytes a second, each
// byte counted once as it is read and once as it is written.
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <iostream>
#include <vector>

int main() {
  constexpr std::size_t kWords = std::size_t{1} << 27;  // 512 MiB
  constexpr int kPasses = 7;
  std::vector<std::uint32_t> buffer(kWords, 1);
  double best_s = 1e9;
  for (int pass = 0; pass < kPasses; ++pass) {
    const auto began = std::chrono::steady_clock::now();
    for (std::uint32_t& word : buffer) word += 3;
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began;
    best_s = std::min(best_s, took.count());
  }
  const double bytes = 2.0 * static_cast<double>(kWords * sizeof buffer[0]);
  // The sum keeps the loops from being thrown away.
  std::uint64_t sum = 0;
  for (const std::uint32_t word : buffer) sum += word;
  std::cout << "{\"bytes_per_s\": " << bytes / best_s << ", \"sum\": " << sum << "}\n";
  return 0;
}
