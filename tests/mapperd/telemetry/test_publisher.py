import json
from typing import Any

import pytest

from mapperd.config.catalog import parameters, value_of
from mapperd.config.live import Applied
from mapperd.events import Severity
from mapperd.telemetry.broker import Kind, Outbox
from mapperd.telemetry.publisher import Reporter
from mapperd.telemetry.topics import Topics
from tests.mapperd.telemetry.conftest import POSE, ROBOT, T0_S, FakeVehicle, below, drained

VITALS = {"cpu_percent": 12.5, "memory_bytes": 1, "disk_free_bytes": {"/state": 5}}


class PublisherHarness:
    """A reporter and its clock."""

    def __init__(self, daemon: FakeVehicle, limit: int = 1000) -> None:
        self.outbox = Outbox(limit)
        topics = Topics.of(daemon.settings.current.mqtt)
        self.reporter = Reporter(daemon, topics, self.outbox, lambda: VITALS, lambda: {"lost": 1})
        self.daemon = daemon
        self.steps = 0

    @property
    def now_s(self) -> float:
        return T0_S + self.steps * 0.05

    def publish(self, seconds: float = 0.0) -> dict[str, list[Any]]:
        """Collect for so long, every 50 ms, with a new pose and ping each time."""
        found: dict[str, list[Any]] = {}
        for _ in range(max(round(seconds / 0.05), 1)):
            self.reporter.collect(self.now_s)
            for topic, payloads in drained(self.outbox).items():
                found.setdefault(topic, []).extend(payloads)
            self.steps += 1
            self.daemon.pings += 1
            self.daemon.pose = {**POSE, "t_s": self.now_s}
        return found


def settings_in(published: dict[str, list[Any]]) -> dict[str, list[Any]]:
    return {topic: values for topic, values in published.items() if topic.startswith("config/")}


def test_all_that_a_broker_keeps_is_reported_at_first(daemon: FakeVehicle) -> None:
    published = PublisherHarness(daemon).publish()
    config = daemon.settings.current
    expected = {f"config/{name}": [value_of(config, name)] for name in parameters()}
    assert settings_in(published) == json.loads(json.dumps(expected))
    assert published["state"] == [
        {
            "t_s": T0_S,
            "uptime_s": 7.0,
            "phase": "mapping",
            "reasons": {"mapper": "pings and odometry come", "sonar": "pings come"},
            "versions": {"mapperd": "1.2.3", "telemetry": 1},
        }
    ]
    assert published["map"][0]["store"] == {"saved_s": 5.0}
    assert published["map"][0]["memory_bytes"] == 1000
    assert published["sonar"][0]["range_m"] == 10.0
    assert published["health"][0]["latency_ms"] == {"p50": 1.0, "p95": 2.0, "p99": None}
    assert published["health"][0]["cpu_percent"] == 12.5
    assert published["health"][0]["telemetry"] == {"lost": 1}


def test_rates_are_those_of_the_convention(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    harness.publish()
    published = harness.publish(60.0)
    counts = {topic: len(payloads) for topic, payloads in published.items()}
    assert counts == {"pose": 300, "sonar": 60, "map": 12, "health": 12, "state": 2}
    assert published["sonar"][-1]["ping_rate_hz"] == pytest.approx(20.0)
    assert published["pose"][0]["frame"] == "map"
    assert published["pose"][0]["child_frame"] == "base_link"
    assert published["pose"][0]["source"] == "dvl"
    assert published["pose"][0]["position_std_m"] == [0.1, 0.1, None]


def test_pose_rate_is_followed_and_a_pose_is_reported_once(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    daemon.settings.follow(("mqtt.pose_rate",), lambda _: None)
    assert isinstance(daemon.settings.apply({"mqtt.pose_rate": 1.0}, "x"), Applied)
    assert harness.reporter.period_s == 0.2
    assert len(harness.publish(10.0)["pose"]) in (10, 11)
    assert isinstance(daemon.settings.apply({"mqtt.pose_rate": 50.0}, "x"), Applied)
    assert harness.reporter.period_s == 0.02
    assert len(harness.publish(1.0)["pose"]) == 20  # as many as there are
    for _ in range(5):
        harness.reporter.collect(harness.now_s)
        harness.steps += 20
    assert len(drained(harness.outbox)["pose"]) == 1


def test_what_a_broker_keeps_is_retained_and_the_rest_is_not(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    daemon.pose, daemon.robots = POSE, [ROBOT]
    daemon.events.add(Severity.INFO, "code", "text")
    harness.reporter.collect(T0_S)
    found: dict[str, tuple[int, bool]] = {}
    while (message := harness.outbox.take(*Kind)) is not None:
        topic = below(message.topic)
        found[topic.partition("/")[0]] = (message.qos, message.retain)
    assert found == {
        "state": (1, True),
        "pose": (0, False),
        "sonar": (0, True),
        "map": (0, True),
        "changes": (1, True),
        "health": (0, False),
        "event": (1, False),
        "config": (1, True),
        "tf": (1, True),
        "sonar_robot_detections": (0, False),
    }


def test_a_change_of_state_is_reported_at_once_but_not_ten_times_a_second(
    daemon: FakeVehicle,
) -> None:
    harness = PublisherHarness(daemon)
    harness.publish(5.0)
    daemon.phase = "waiting"
    assert harness.publish()["state"][0]["phase"] == "waiting"
    count = 0
    for k in range(100):
        daemon.phase = f"phase {k}"
        count += len(harness.publish().get("state", ()))
    assert count in (4, 5)
    assert harness.publish(2.0)["state"][-1]["phase"] == "phase 99"


def test_a_changed_setting_is_reported_and_the_sonar_s_place_with_it(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    (before,) = harness.publish()["tf"]
    assert before["child_frame"] == "sonar_link"
    assert before["position_m"] == [0.0, 0.0, -0.5]
    daemon.settings.apply({"filtering.min_range": 2.0}, "x")
    assert settings_in(harness.publish()) == {"config/filtering.min_range": [2.0]}
    daemon.settings.apply({"mounting.orientation.pitch": 0.0}, "x")
    published = harness.publish()
    assert settings_in(published) == {"config/mounting.orientation.pitch": [0.0]}
    assert published["tf"][0]["orientation_wxyz"] == [1.0, 0.0, 0.0, 0.0]


def test_robots_are_reported_when_they_are_seen_and_when_they_are_gone(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    topic = "sonar_robot_detections"
    assert topic not in harness.publish(1.0)
    daemon.robots = [ROBOT]
    assert harness.publish(1.0)[topic] == [
        {"t_s": pytest.approx(T0_S + 1.0), "frame": "map", "expire_s": 10.0, "robots": [ROBOT]}
    ]
    for k in range(100):
        daemon.robots = [{**ROBOT, "t_s": T0_S + k}]
        harness.publish()
    daemon.robots = []
    assert harness.publish(1.0)[topic][-1]["robots"] == []


def test_events_wait_where_they_are_kept_while_there_is_no_room(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon, limit=10)
    for k in range(35):
        daemon.events.add(Severity.NOTICE, "code", f"event {k}", value_m=k)
    numbers = []
    while events := harness.publish().get("event", []):
        assert len(events) <= 10
        numbers += [event["number"] for event in events]
    assert numbers == list(range(1, 36))
    assert harness.outbox.dropped[Kind.EVENT] == 0


def test_forgotten_events_are_counted_and_reported(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon, limit=2000)
    for k in range(1200):
        daemon.events.add(Severity.NOTICE, "code", f"event {k}")
    events = harness.publish()["event"]
    assert events[0]["code"] == "events_missed"
    assert events[0]["facts"] == {"missed": 200}
    assert [event["number"] for event in events[1:]] == list(range(201, 1201))
    assert harness.reporter.events_missed == 200
    assert "event" not in harness.publish()


def test_everything_is_reported_again_to_a_new_connection(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    first = harness.publish(3.0)
    daemon.events.add(Severity.NOTICE, "code", "text")
    harness.publish()
    harness.reporter.renew()
    again = harness.publish()
    kept = {topic for topic in first if topic.startswith(("config/", "state", "map", "sonar"))}
    assert kept <= set(again)
    assert "event" not in again  # those were published
