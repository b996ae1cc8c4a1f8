"""How the page shows the connection."""

import errno
import math
import os

import pytest

from mapperd.client import ConnectionStatus
from mapperd.viewer.colours import Scale, legend_of
from mapperd.viewer.health import (
    Health,
    Rate,
    banner_html,
    health_html,
    legend_html,
    summary_html,
)

SECOND = 1_000_000_000


def linked(state: str, reason: str = "", connects: int = 1) -> Health:
    return Health(ConnectionStatus(state, "10.0.0.2:52300", reason, 100.0, connects))  # type: ignore[arg-type]


def test_a_rate_is_of_the_last_seconds_and_starts_again_with_the_daemon() -> None:
    rate = Rate()
    assert rate.per_s is None
    for second in range(10):
        rate.add(float(second), 20.0 * second if second < 5 else 100.0)
    assert rate.per_s == pytest.approx(0.0)
    rate.add(10.0, 0.0)
    assert rate.per_s is None
    rate.add(11.0, 5.0)
    assert rate.per_s == pytest.approx(5.0)


def test_a_lost_link_is_reported_in_big_letters_and_for_how_long() -> None:
    health = linked("waiting", "connection refused")
    text = banner_html(health, 175.0)
    assert "LINK LOST 1:15" in text
    assert "10.0.0.2:52300: connection refused" in text
    assert "LINK LOST 1:15" in health_html(health, 175.0, 0)
    assert "NO LINK 5 s" in banner_html(linked("connecting", connects=0), 105.0)
    assert banner_html(linked("connected"), 105.0) == ""


@pytest.mark.parametrize("number", [errno.ENOENT, errno.ECONNREFUSED])
def test_where_no_daemon_ever_answered_the_banner_names_the_remedy(number: int) -> None:
    reason = os.strerror(number)
    never = banner_html(linked("waiting", reason, connects=0), 105.0)
    assert "no daemon answers: start mapperd, or give --address" in never
    assert reason not in never
    lost = banner_html(linked("waiting", reason), 105.0)
    assert "no daemon answers<br>" in lost


def test_a_file_is_shown_by_its_name() -> None:
    health = linked("connected")
    health.take_status({"phase": "file", "reason": "/home/me/a<b.map"}, {}, 0.0)
    text = health_html(health, 105.0, 0)
    assert "a&lt;b.map" in text
    assert "10.0.0.2" not in text
    health.take_status({"phase": "mapping", "reason": ""}, {}, 0.0)
    assert "daemon: 10.0.0.2:52300" in health_html(health, 105.0, 0)


def test_ages_are_by_the_daemon_s_clock() -> None:
    health = linked("connected")
    ahead = 3600 * SECOND
    health.heartbeat(ahead + 10 * SECOND, 10 * SECOND + SECOND // 2)  # half a second under way
    health.heartbeat(ahead + 11 * SECOND, 11 * SECOND + SECOND // 50)
    health.pose_ns = ahead + 11 * SECOND
    assert health.age_s(health.pose_ns, 12 * SECOND) == pytest.approx(0.98)
    assert health.age_s(None, 12 * SECOND) is None
    health.reconnected()
    assert health.ahead_ns is None


def test_rates_drops_and_latencies_are_shown() -> None:
    health = linked("connected")
    link = {"round_trip_s": 0.31, "left": 42, "skipped": {"returns": 7, "image": 2}}
    for second in (0, 1, 2):
        pings = {"mapped": 12 * second, "dropped": {"no_odometry": 3, "too_slow": 0}}
        health.take_status({"phase": "mapping", "pings": pings}, link, float(second))
        health.kilobytes.add(float(second), 55.5 * second)
    health.pose_ns = 10 * SECOND
    text = health_html(health, 102.0, 14 * SECOND)
    for message in (
        "CONNECTED",
        "mapping",
        "12.0 /s",
        "55.5 kB/s",
        "310 ms",
        "no_odometry 3",
        "4.0 s",
    ):
        assert message in text
    assert ">42<" in text
    assert ">9<" in text
    assert "too_slow" not in text


def test_text_of_the_daemon_is_escaped() -> None:
    health = linked("waiting", "<script>alert(1)</script>")
    health.take_status({"phase": "<b>", "pings": {"dropped": {"<i>": 1}}}, {}, 0.0)
    for text in (health_html(health, 101.0, 0), banner_html(health, 101.0)):
        assert "<script" not in text
        assert "<i>" not in text
        assert "<b>" not in text


def test_nonsense_in_a_status_is_passed_over() -> None:
    health = linked("connected")
    health.take_status(
        {"pings": 3, "phase": None}, {"left": "x", "skipped": [], "round_trip_s": None}, 0.0
    )
    health.take_status({"pings": {"mapped": "many", "dropped": 4}}, {"skipped": {"a": "b"}}, 1.0)
    assert (health.left, health.skipped, health.dropped) == (0, 0, {})


def test_the_legend_has_numbers_and_the_unit() -> None:
    text = legend_html(legend_of(Scale("height", -7, -3)))
    assert "height z (m)" in text
    for tick in ("-7.0", "-5.0", "-3.0"):
        assert f">{tick}<" in text


def test_banner_mentions_the_map_only_if_there_was_one() -> None:
    assert "the map shows the last state" in banner_html(linked("waiting"), 105.0)
    never = banner_html(linked("waiting", connects=0), 105.0)
    assert "the map" not in never
    assert "connecting" in never


def test_a_lost_link_is_lost_since_the_first_failure_not_the_last() -> None:
    health = Health()

    def take(state: str, since_s: float, connects: int = 1) -> None:
        health.take_link(ConnectionStatus(state, "10.0.0.2:52300", "", since_s, connects))  # type: ignore[arg-type]

    take("connected", 90.0)
    for since_s in (100.0, 103.0, 108.0):
        take("waiting", since_s)
        take("connecting", since_s + 1)
    assert "LINK LOST 15 s" in banner_html(health, 115.0)
    take("waiting", 113.0, connects=2)  # it was there between two looks
    assert "LINK LOST 2 s" in banner_html(health, 115.0)
    take("connected", 120.0, connects=3)
    take("waiting", 130.0, connects=3)
    assert "LINK LOST 5 s" in banner_html(health, 135.0)


def test_depth_and_heading_are_shown_without_a_position() -> None:
    health = linked("connected")
    newest: dict[str, object] = {"depth_m": 4.5, "map_q_base_wxyz": [1.0, 0.0, 0.0, 0.0]}
    odometry = {"newest": newest, "north_referenced": True}
    status = {"phase": "mapping", "activity": "not mapping", "odometry": odometry}
    health.take_status(status, {}, 0.0)
    text = health_html(health, 0.0, 0)
    assert "depth <b>4.50 m</b> &middot; heading 090&deg;" in text
    assert "m &middot; y" not in summary_html(health, 0.0)
    assert "&middot; not mapping" in text
    newest["depth_m"] = None
    health.take_status(status | {"odometry": odometry | {"north_referenced": False}}, {}, 0.0)
    assert "depth" not in health_html(health, 0.0, 0)
    assert "yaw +0&deg;" in health_html(health, 0.0, 0)


def test_the_vehicle_and_the_recording_are_shown() -> None:
    health = linked("connected")
    assert "depth" not in health_html(health, 0.0, 0)
    health.position_m, health.yaw_rad = (1.5, -2.0, -3.25), math.radians(30)
    health.take_status({"phase": "mapping", "recording": None}, {}, 0.0)
    text = health_html(health, 0.0, 0)
    for message in ("depth <b>3.25 m</b>", "yaw +30&deg;", "x 1.50 m", "y -2.00 m", "not recorded"):
        assert message in text
    assert "depth <b>3.25 m</b>" in summary_html(health, 0.0)
    health.take_status({"odometry": {"north_referenced": True}}, {}, 0.0)
    assert "heading 060&deg;" in health_html(health, 0.0, 0)
    recording = {"state": "logging", "reason": None, "bytes_written": 12_300_000}
    health.take_status({"recording": recording}, {}, 1.0)
    assert "recording: 12 MB" in health_html(health, 0.0, 0)
    assert "recording: 12 MB" in summary_html(health, 0.0)
    paused = recording | {"state": "paused", "reason": "no space left"}
    health.take_status({"recording": paused}, {}, 2.0)
    assert "recording paused: no space left" in health_html(health, 0.0, 0)
