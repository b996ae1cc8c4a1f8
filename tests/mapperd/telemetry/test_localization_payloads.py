"""Localization topics: contents, rates and requests."""

import asyncio
import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from mapperd.config.tree import AmclConfig, MqttConfig
from mapperd.telemetry.payloads import SAMPLE
from mapperd.telemetry.topics import Asked, Topics
from tests.mapperd.localization.believed import STAMP_NS, snapshot
from tests.mapperd.telemetry.conftest import ROOT, T0_S, FakeVehicle, drained
from tests.mapperd.telemetry.test_publisher import PublisherHarness
from tests.mapperd.telemetry.test_requests import Asker
from tests.support.peers.mosquitto import mosquitto_path, running_mosquitto
from tests.support.process import free_tcp_port

POSE = {"x_m": 1.5, "y_m": -2, "yaw_rad": 0.5}
OURS = ("amcl_pose", "map_odom", "particle_cloud", "diagnostics")


def test_all_is_reported_under_the_published_names(daemon: FakeVehicle) -> None:
    daemon.localized = snapshot(0.2)
    published = PublisherHarness(daemon).publish()
    (pose,), (moved,), (cloud,), (levels,) = (published[topic] for topic in OURS)
    assert (pose["x_m"], pose["y_m"], pose["yaw_rad"]) == (1.0, 2.0, 0.5)
    assert pose["covariance"][1][1] == pytest.approx(0.04)
    assert (pose["frame"], pose["state"]) == ("map", "ambiguous")
    assert moved["position_m"] == [3.0, -4.0, 0.0]
    assert moved["t_s"] == STAMP_NS / 1e9 + 1
    assert (cloud["particles"], len(cloud["sample_x_y_yaw_weight"])) == (5000, SAMPLE)
    assert cloud["clusters"][0]["mass"] == 0.8
    assert (levels["t_s"], levels["level"], levels["state"]) == (T0_S, "OK", "ambiguous")
    assert levels["std_x"]["warn_level"] == 0.2


def test_nothing_is_reported_while_it_is_off(daemon: FakeVehicle) -> None:
    assert not set(OURS) & set(PublisherHarness(daemon).publish(6.0))


def test_without_a_belief_levels_alone_are_reported(daemon: FakeVehicle) -> None:
    daemon.localized = snapshot(None, transform=None)
    published = PublisherHarness(daemon).publish()
    assert set(OURS) & set(published) == {"diagnostics"}
    assert published["diagnostics"][0]["text"] == "no estimate yet"


def test_rates_are_bounded(daemon: FakeVehicle) -> None:
    harness = PublisherHarness(daemon)
    found: dict[str, int] = dict.fromkeys(OURS, 0)
    base = snapshot(0.0)
    assert base.transform is not None
    for k in range(200):  # a scan every 50 ms for 10 s
        later = STAMP_NS + k * 50_000_000
        moved = dataclasses.replace(base.transform, stamp_ns=later)
        daemon.localized = dataclasses.replace(base, stamp_ns=later, transform=moved)
        published = harness.publish()
        for topic in OURS:
            found[topic] += len(published.get(topic, []))
    assert 45 <= found["amcl_pose"] <= 51
    assert 45 <= found["map_odom"] <= 51
    assert 9 <= found["particle_cloud"] <= 11
    assert 2 <= found["diagnostics"] <= 3


def test_nothing_is_reported_twice(daemon: FakeVehicle) -> None:
    daemon.localized = snapshot(0.0)
    published = PublisherHarness(daemon).publish(4.0)
    assert [len(published[topic]) for topic in OURS] == [1, 1, 1, 1]


def test_levels_are_reported_when_they_change(daemon: FakeVehicle) -> None:
    daemon.localized = snapshot(0.0)
    harness = PublisherHarness(daemon)
    harness.publish(1.5)
    daemon.localized = snapshot(0.0, std=0.5)
    (levels,) = harness.publish(1.5)["diagnostics"]
    assert (levels["level"], levels["std_x"]["level"]) == ("WARN", "WARN")


def test_requests_are_obeyed(daemon: FakeVehicle) -> None:
    asker = Asker(daemon)
    for below, body in (
        ("cmd/initial_pose", {"pose": POSE}),
        ("cmd/initialpose", {"pose": POSE}),
        ("cmd/request_nomotion_update", {}),
        ("cmd/set_map", {"name": "tank.yaml", "pose": POSE}),
        ("cmd/map", {"name": "tank.yaml"}),
    ):
        (answer,) = asker.ask(below, {"id": 1, **body})[f"{below}/result"]
        assert answer["ok"], answer
    assert daemon.asked == [
        ("initial_pose", "1.5", "mqtt"),
        ("initial_pose", "1.5", "mqtt"),
        ("request_nomotion_update", "mqtt"),
        ("set_map", "tank.yaml", "1.5", "mqtt"),
        ("set_map", "tank.yaml", "", "mqtt"),
    ]


@pytest.mark.parametrize(
    ("name", "body", "reason"),
    [
        ("global_localization", {}, "no_map"),
        ("global_localization", {"pose": POSE}, "bad_request"),
        ("initial_pose", {}, "bad_request"),
        ("initial_pose", POSE, "bad_request"),
        ("initial_pose", {"pose": POSE | {"x_m": 1e7}}, "bad_request"),
        ("initial_pose", {"pose": POSE | {"x_m": None}}, "bad_request"),
        ("initial_pose", {"pose": POSE | {"covariance": [1, 2]}}, "bad_request"),
        ("set_map", {"pose": POSE}, "bad_request"),
        ("set_map", {"name": "a.map", "pose": None}, "bad_request"),
        ("set_map", {"name": ["a.map"]}, "bad_request"),
        ("static_map", {"name": "a.map"}, "unknown_command"),
    ],
)
def test_what_cannot_be_is_refused(
    daemon: FakeVehicle, name: str, body: dict[str, Any], reason: str
) -> None:
    (answer,) = Asker(daemon).ask(f"cmd/{name}", {"id": 1, **body})[f"cmd/{name}/result"]
    assert (answer["ok"], answer["reason"]) == (False, reason)
    assert daemon.asked == []


def test_not_a_number_is_no_json(daemon: FakeVehicle) -> None:
    payload = json.dumps({"id": 1, "pose": POSE | {"x_m": float("nan")}}).encode()
    (answer,) = Asker(daemon).ask("cmd/initial_pose", payload)["cmd/initial_pose/result"]
    assert (answer["ok"], answer["reason"]) == (False, "bad_request")


def test_settings_name_the_topics() -> None:
    amcl = AmclConfig(initial_pose_topic="/rviz/pose", map_topic="chart")
    topics = Topics.of(MqttConfig(vehicle="rov-1"), amcl)
    assert topics.requests[2:] == (f"{ROOT}/cmd/rviz/pose",)
    assert topics.also == {"rviz/pose": "initial_pose", "chart": "set_map"}
    assert topics.asked(f"{ROOT}/cmd/rviz/pose") == Asked("cmd", "rviz/pose")
    assert topics.asked(f"{ROOT}/cmd/rviz/pose/result") is None
    assert topics.asked(f"{ROOT}/cmd/chart") == Asked("cmd", "chart")
    bare = Topics.of(MqttConfig(vehicle="rov-1"), AmclConfig(use_map_topic=False))
    assert bare.also == {"initialpose": "initial_pose"}


def test_a_command_keeps_its_name(daemon: FakeVehicle) -> None:
    asker = Asker(daemon, AmclConfig(map_topic="reset"))
    (answer,) = asker.ask("cmd/reset", {"id": 1})["cmd/reset/result"]
    assert answer["ok"]
    assert daemon.asked == [("reset", "mqtt")]
    assert drained(asker.outbox) == {}


def test_mosquitto_carries_it(tmp_path: Path) -> None:
    pytest.importorskip("aiomqtt")
    from tests.mapperd.telemetry import test_mosquitto as broker  # noqa: PLC0415 needs aiomqtt

    if mosquitto_path() is None:
        pytest.skip("Mosquitto is not installed")
    port = free_tcp_port()
    daemon = FakeVehicle({"port": port, "commands": True})
    daemon.localized = snapshot(0.2)

    async def run() -> None:
        async with broker.listening(port) as shore, broker.running_telemetry(daemon):
            assert (await shore.hears("amcl_pose"))["x_m"] == 1.0
            assert (await shore.hears("map_odom"))["child_frame"] == "odom"
            assert len((await shore.hears("particle_cloud"))["sample_x_y_yaw_weight"]) == SAMPLE
            assert (await shore.hears("diagnostics"))["level"] == "OK"
            await shore.publish("cmd/initialpose", {"id": 1, "pose": POSE})
            assert (await shore.hears("cmd/initialpose/result"))["ok"]
            await shore.publish("cmd/global_localization", {"id": 2})
            refusal = await shore.hears("cmd/global_localization/result")
            assert refusal["reason"] == "no_map"
        assert daemon.asked == [("initial_pose", "1.5", "mqtt")]

    with running_mosquitto(tmp_path, port):
        asyncio.run(run())
