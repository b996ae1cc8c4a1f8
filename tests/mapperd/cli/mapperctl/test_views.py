import pytest

from mapperd.cli.mapperctl.views import status_lines

STATUS = {
    "phase": "mapping",
    "reason": "sonar pings",
    "version": "1.2.3",
    "uptime_s": 3725.4,
    "sonar": {"state": "pinging", "range_m": 10.0, "temperature_c": 21.25, "bytes": 3 << 20},
    "pose": None,
    "pings": {"total": 1000, "mapped": 990, "dropped": {"too_slow": 10}, "waiting": 0},
    "latency_ms": {"p50": 12.3456, "p95": None},
    "map": {"memory_bytes": 1 << 30, "resolution_m": 0.05},
    "behind": {"late": True, "dropped": 3, "ready": 0},
    "robots": [],
    "servers": {
        "control": {"clients": 2, "counters": {"accepted": 7}},
        "stream": {"clients": 1, "watching": [{"name": "page", "left": 5}]},
    },
}


def test_what_there_is_is_reported_with_its_units() -> None:
    assert list(status_lines(STATUS, None)) == [
        "mapperd 1.2.3 mapping: sonar pings, up 1:02:05",
        "sonar      state pinging, range 10 m, temperature 21.25 °C, 3.0 MiB",
        "pings      total 1000, mapped 990, dropped too slow 10, waiting 0",
        "latency_ms p50 12.35",
        "map        memory 1024.0 MiB, resolution 0.05 m",
        "behind     late, dropped 3, ready 0",
        "servers    control clients 2, control counters accepted 7, stream clients 1",
    ]


@pytest.mark.parametrize(
    ("mapped", "uptime_s", "rate"),
    [(970, 3723.4, ", 10.0 pings/s"), (2000, 3723.4, ""), (970, 9999.0, "")],
)
def test_rate_is_that_since_the_last_look(mapped: int, uptime_s: float, rate: str) -> None:
    before = {"uptime_s": uptime_s, "pings": {"mapped": mapped}}
    head = next(iter(status_lines(STATUS, before)))
    assert head == f"mapperd 1.2.3 mapping: sonar pings, up 1:02:05{rate}"


@pytest.mark.parametrize("status", [{}, {"phase": None}, {"pings": 3, "sonar": {"state": None}}])
def test_any_daemon_has_a_headline(status: dict[str, object]) -> None:
    assert list(status_lines(status, {})) == [next(iter(status_lines(status, None)))]


def test_nothing_moves_the_cursor() -> None:
    lines = list(status_lines({"phase": "\x1b[2J", "sonar": {"reason": "a\nb"}}, None))
    assert lines == ["mapperd ?[2J, up 0:00:00", "sonar      reason a?b"]
