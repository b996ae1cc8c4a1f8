/// \file
/// \brief A loop on several threads.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "mapperd/common/progress.hpp"

namespace mapperd {

/// Runs task(0) ... task(count - 1); the assignment to threads is unspecified. If the system has no
/// more threads, fewer are used. Rethrows the first exception of a task, after which no further
/// task starts. Each finished task counts as progress.
template <typename Task>
void run_parallel(std::size_t count, int threads, const Task& task) {
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  std::mutex failing;
  const auto work = [&] {
    try {
      for (std::size_t i = next++; i < count; i = next++) {
        task(i);
        finish_part();
      }
    } catch (...) {
      const std::lock_guard<std::mutex> lock(failing);
      if (!failure) failure = std::current_exception();
      next = count;
    }
  };
  std::vector<std::thread> helpers;
  try {
    for (int i = 1; i < threads && static_cast<std::size_t>(i) < count; ++i) {
      helpers.emplace_back(work);
    }
  } catch (const std::exception&) {  // NOLINT(bugprone-empty-catch)
    // The system has no more threads: those that started, and this one, do all tasks.
  }
  work();
  for (std::thread& helper : helpers) helper.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace mapperd
