// Who may touch a map when: any number of threads that read, or one that writes.
#pragma once

#include <mutex>
#include <shared_mutex>

namespace mapperd::map {

// A shared mutex on which readers that follow each other closely cannot keep a writer waiting for
// ever, as they may on a std::shared_mutex: everybody queues at the same turnstile, and a writer
// waits in it for the readers inside to leave. Not recursive: a thread that reads and asks to read
// again, while another waits to write, waits for itself.
class MapMutex {
 public:
  MapMutex() = default;
  // A map that moves takes its content along, and leaves its lock, which nobody may hold then.
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
