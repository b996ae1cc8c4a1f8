/// \file
/// \brief The lock of a map: many readers or one writer.
#pragma once

#include <mutex>
#include <shared_mutex>

namespace mapperd::map {

/// A shared mutex without starvation of writers, which std::shared_mutex permits: all threads queue
/// at one turnstile, and a writer waits in it until the readers inside leave. Not recursive: a
/// reader that locks again while a writer waits deadlocks.
class MapMutex {
 public:
  MapMutex() = default;
  /// Moving a map moves its content, not its lock, which must be free.
  MapMutex(MapMutex&& /*other*/) noexcept {}
  MapMutex& operator=(MapMutex&& /*other*/) noexcept { return *this; }

  void lock() {
    const std::lock_guard<std::mutex> turn(turnstile_);
    content_.lock();
  }
  void unlock() { content_.unlock(); }

  void lock_shared() {
    const std::lock_guard<std::mutex> turn(turnstile_);
    content_.lock_shared();
  }
  void unlock_shared() { content_.unlock_shared(); }

 private:
  std::mutex turnstile_;
  std::shared_mutex content_;
};

}  // namespace mapperd::map
