import pytest

from mapperd.pipeline.counters import Latency

MS = 1_000_000
MINUTE = 60_000 * MS


def test_percentiles_are_of_the_last_minute() -> None:
    latency = Latency()
    latency.add(0, 5000 * MS)
    for k in range(1, 101):
        latency.add(MINUTE, MINUTE + k * MS)
    now = 5000 * MS + MINUTE + 1
    found = latency.percentiles_ms(now)
    assert found is not None
    assert list(found.values()) == pytest.approx([50.5, 95.05, 99.01])


def test_there_is_invalid_without_pings() -> None:
    latency = Latency()
    assert latency.percentiles_ms(0) is None
    latency.add(0, 1)
    assert latency.percentiles_ms(2 * MINUTE) is None
