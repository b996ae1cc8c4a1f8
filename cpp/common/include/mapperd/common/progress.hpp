/// \file
/// \brief Progress of long computations, for a watchdog.
///
/// \par Threads
/// Any thread may call everything.
#pragma once

#include <atomic>
#include <cstdint>

namespace mapperd {

/// Finished parts of all computations of this process. Grows while a long computation makes
/// progress; the size of a part is unspecified.
inline std::atomic<std::uint64_t> finished_parts{0};

/// Counts a finished part.
inline void finish_part() { finished_parts.fetch_add(1, std::memory_order_relaxed); }

}  // namespace mapperd
