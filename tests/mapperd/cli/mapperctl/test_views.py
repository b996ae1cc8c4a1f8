import math

import pytest

from mapperd.cli.mapperctl.views import status_lines

STATUS = {
    "phase": "mapping",
    "reason": "sonar pings",
    "version": "1.2.3",
    "t_s": 1000.0,
    "uptime_s": 3725.4,
    "problems": [],
    "sonar": {
        "state": "pinging",
        "reason": "pings arrive",
        "pings": 1000,
        "model": "M750d",
        "address": "192.168.2.4",
        "range_m": 10.0,
        "gain_percent": 50.0,
        "temperature_c": 21.25,
    },
    "odometry": {
        "connections": {"dvl": {"state": "receiving"}, "autopilot": {"state": "opening"}},
        "quantities": {
            "position": {"newest_ns": 999_900_000_000},
            "depth": {"newest_ns": None},
            "attitude": {"newest_ns": 878_000_000_000},
        },
    },
    "pose": {
        "t_s": 999.5,
        "position_m": [1.0, -2.5, -7.25],
        "map_q_base_wxyz": [math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)],
        "position_std_m": [0.03, 0.04, 0.1],
    },
    "pings": {"total": 1000, "mapped": 990, "dropped": {"too_slow": 10}, "waiting": 0},
    "latency_ms": {"p50": 12.3456, "p95": 20.0},
    "map": {"memory_bytes": 1 << 30, "resolution_m": 0.05},
    "store": {"path": "/maps/dive.map", "reason": None, "bricks_lost": 0},
    "recording": {"state": "logging", "reason": None, "bytes_written": 3 << 20, "bytes_dropped": 0},
    "behind": {"late": True, "dropped": 3, "ready": 0},
    "robots": [],
    "servers": {"stream": {"clients": 1, "watching": [{"name": "page", "left": 5}]}},
}
BEFORE = {"uptime_s": 3723.4, "sonar": {"pings": 976}, "pings": {"mapped": 970}}


def test_one_screen_for_people() -> None:
    assert list(status_lines(STATUS, BEFORE)) == [
        "mapperd 1.2.3 mapping, up 1:02:05",
        "vehicle       x 1.00 m, y -2.50 m, depth 7.25 m, yaw +45°, ± 0.05 m, 0.5 s ago",
        "sonar         pinging 12.0/s, M750d at 192.168.2.4, range 10 m, gain 50 %,",
        "              21.25 °C",
        "odometry      dvl receiving",
        "odometry      autopilot opening",
        "              position 0.1 s ago, attitude 0:02:02 ago",
        "pings         990 mapped 10.0/s, 10 dropped (too slow 10), latency 20 ms",
        "              pings come faster than they can be mapped, 3 dropped",
        "map           voxels of 0.05 m, 1024.0 MiB in memory, kept in /maps/dive.map",
        "recording     logging, 3.0 MiB",
        "clients       1",
    ]


@pytest.mark.parametrize(("returns", "shown"), [(512, "(from 512 first returns)"), (None, "(set)")])
def test_the_level_of_the_arc_rule_is_shown(returns: int | None, shown: str) -> None:
    facts = STATUS["map"]
    assert isinstance(facts, dict)
    facts = facts | {"rule": "arc", "surface_level": 34.5, "surface_returns": returns}
    text = " ".join(" ".join(status_lines(STATUS | {"map": facts}, None)).split())
    assert f"rule arc, surfaces at level 34.5 {shown}" in text


def test_a_heading_is_of_a_world_with_north() -> None:
    odometry = STATUS["odometry"]
    assert isinstance(odometry, dict)
    odometry = odometry | {"north_referenced": True}
    assert "heading 045°" in "\n".join(status_lines(STATUS | {"odometry": odometry}, None))


def test_depth_and_heading_are_shown_without_a_position() -> None:
    newest = {"depth_m": 4.5, "map_q_base_wxyz": [1.0, 0.0, 0.0, 0.0]}
    status = {
        "version": "1.2.3",
        "phase": "mapping",
        "activity": "not mapping",
        "uptime_s": 1.0,
        "odometry": {"newest": newest, "north_referenced": True},
    }
    head, vehicle, *_ = status_lines(status, None)
    assert head == "mapperd 1.2.3 not mapping, up 0:00:01"
    assert vehicle == "vehicle       depth 4.50 m, heading 090°"


def test_problems_come_first_and_fit() -> None:
    texts = ["no odometry: nothing arrives. " + "Do this or that. " * 8, "b", "c", "d"]
    problems = [{"code": "no_odometry", "text": text} for text in texts]
    lines = list(status_lines({**STATUS, "problems": problems}, None))
    assert lines[0].startswith("! no odometry: nothing arrives.")
    assert lines[3:6] == ["! b", "! c", "! 1 more problems: --json"]
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 24


def test_colours_name_what_needs_attention() -> None:
    problems = [{"code": "no_sonar", "text": "no sonar"}]
    status = {**STATUS, "problems": problems, "recording": None}
    lines = list(status_lines(status, BEFORE, colours=True))
    assert lines[0] == "\x1b[31m! no sonar\x1b[0m"
    assert "\x1b[33mrecording     off\x1b[0m" in lines
    assert "\x1b[32modometry      dvl receiving\x1b[0m" in lines
    assert "\x1b[33modometry      autopilot opening\x1b[0m" in lines


@pytest.mark.parametrize("uptime_s", [3723.4, 9999.0])
def test_no_rate_after_a_restart(uptime_s: float) -> None:
    before = {"uptime_s": uptime_s, "pings": {"mapped": 2000}}
    (line,) = (one for one in status_lines(STATUS, before) if one.startswith("pings"))
    assert line.startswith("pings         990 mapped, ")


@pytest.mark.parametrize(
    "status", [{}, {"phase": None}, {"pings": 3, "sonar": {"state": None}, "problems": None}]
)
def test_any_daemon_has_a_headline(status: dict[str, object]) -> None:
    assert list(status_lines(status, {})) == ["mapperd, up 0:00:00"]


def test_nothing_moves_the_cursor() -> None:
    status = {"phase": "\x1b[2J", "sonar": {"state": "silent", "reason": "a\nb"}}
    assert list(status_lines(status, None)) == [
        "mapperd ?[2J, up 0:00:00",
        "sonar         silent: a?b",
    ]


def test_a_map_with_holes_or_an_unwritable_file_is_marked() -> None:
    store = {"path": "/maps/dive.map", "reason": "the disk is full", "bricks_lost": 3}
    lines = list(status_lines({**STATUS, "store": store}, BEFORE, colours=True))
    (start,) = (at for at, line in enumerate(lines) if "voxels of" in line)
    assert lines[start].startswith("\x1b[33mmap")
    assert "3 bricks lost, the disk is full" in lines[start + 1]
