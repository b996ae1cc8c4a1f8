import tracemalloc

import numpy as np

from mapperd.server.encoder import RevisionTimes

LOOKS = 200_000
NS = 100_000_000


def test_times_of_a_long_session_take_little_memory() -> None:
    times = RevisionTimes()
    tracemalloc.start()
    try:
        for look in range(1, LOOKS + 1):
            times.note(3 * look, look * NS)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 2 << 20
    known_ns = times.of(np.array([3, 3 * LOOKS // 2, 3 * LOOKS - 1, 3 * LOOKS], np.uint64))
    assert known_ns[2:].tolist() == [LOOKS * NS] * 2
    assert np.all(np.abs(known_ns - NS * np.array([1, LOOKS // 2, LOOKS, LOOKS])) < 64 * NS)
