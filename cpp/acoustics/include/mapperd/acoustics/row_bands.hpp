/// \file
/// \brief Division of rows among threads.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <thread>
#include <vector>

namespace mapperd::acoustics {

/// Calls work(first, last) for bands that together are all rows. Rows are independent, so the
/// number of bands does not change the result.
template <typename Work>
void in_row_bands(std::size_t rows, unsigned threads, const Work& work) {
  const std::size_t bands = std::max<std::size_t>(1, std::min<std::size_t>(threads, rows));
  std::vector<std::thread> others;
  others.reserve(bands - 1);
  for (std::size_t band = 1; band < bands; ++band) {
    others.emplace_back(work, rows * band / bands, rows * (band + 1) / bands);
  }
  work(std::size_t{0}, rows / bands);
  for (std::thread& other : others) other.join();
}

}  // namespace mapperd::acoustics
