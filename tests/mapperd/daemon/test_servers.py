"""Telemetry and pictures beside a real daemon."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.config.layers import Layered
from mapperd.config.live import Applied, ConfigStore
from mapperd.config.loader import config_of
from mapperd.daemon.daemon import Daemon
from mapperd.daemon.servers import serving
from mapperd.daemon.session import Live, host_clock
from mapperd.errors import ConfigError
from mapperd.events import EventLog
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.pipeline.worker import snapshot_reader
from mapperd.telemetry.broker import Outbox
from mapperd.telemetry.publisher import Reporter
from mapperd.telemetry.topics import Topics
from tests.mapperd.telemetry.conftest import drained
from tests.support.process import free_tcp_port

CLOCK = host_clock()


def daemon_of(tmp_path: Path, mqtt: dict[str, Any], **more: dict[str, Any]) -> Daemon:
    tree = {"mqtt": {"vehicle": "rov-1", **mqtt}, "device": {"address": "127.0.0.1"}, **more}
    settings, events = ConfigStore(Layered(config_of(tree, ""))), EventLog(CLOCK)
    sonar_map = SonarMap(settings.current)
    live = Live(sonar_map, FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0))), clock=CLOCK)
    return Daemon(settings, sonar_map, live, events, read=Layered, folder=tmp_path)


def test_the_status_of_a_real_daemon_can_be_reported(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path, {})
    outbox = Outbox(100)
    reporter = Reporter(daemon, Topics.of(daemon.settings.current.mqtt), outbox, dict, dict)
    reporter.collect(CLOCK() / 1e9)
    stated = drained(outbox)
    assert {"state", "sonar", "map", "health", "tf"} <= set(stated)
    assert stated["state"][0]["phase"] == "starting"
    assert stated["map"][0]["resolution_m"] == 0.05
    assert stated["map"][0]["rule"] == "iwlo"


def test_status_and_telemetry_state_the_level_of_the_arc_rule(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path, {}, mapping={"rule": "arc"})
    intensity = np.ones((200, 16), dtype=np.float32)
    intensity[150:160] = 40.0
    mapping = daemon.live.mapping
    sonar_map = mapping.pipeline.executor.stages.map
    sonar_map.skip(PingImage(intensity, np.linspace(-0.3, 0.3, 16), 0.02))
    mapping.snapshot = snapshot_reader(CLOCK)(mapping)
    facts = daemon.status()["map"]
    assert facts.items() >= sonar_map.rule_facts().items()
    assert facts["rule"] == "arc"
    assert facts["surface_returns"] > 0
    outbox = Outbox(100)
    reporter = Reporter(daemon, Topics.of(daemon.settings.current.mqtt), outbox, dict, dict)
    reporter.collect(CLOCK() / 1e9)
    assert drained(outbox)["map"][0]["surface_level"] == facts["surface_level"]


def test_a_dead_broker_is_in_the_status_and_the_daemon_goes_on(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path, {"host": "127.0.0.1", "port": free_tcp_port()})

    async def run() -> None:
        async with serving(daemon, tmp_path, {}, CLOCK):
            async with asyncio.timeout(60):
                while not daemon.status()["servers"]["mqtt"]["lost"]:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
            changes = {"mqtt.pose_rate": 1.0}
            assert isinstance(daemon.settings.apply(changes, "test"), Applied)
        assert daemon.status()["servers"]["mqtt"]["phase"] == "closed"

    asyncio.run(run())


def test_a_broker_that_cannot_be_talked_to_is_refused_at_the_start(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path, {"host": "127.0.0.1", "password_file": "/nowhere"})

    async def run() -> None:
        async with serving(daemon, tmp_path, {}, CLOCK):
            pass

    with pytest.raises(ConfigError, match=r"mqtt\.password_file: /nowhere"):
        asyncio.run(run())


def test_without_a_broker_there_is_no_telemetry(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path, {})

    async def run() -> None:
        async with serving(daemon, tmp_path, {}, CLOCK):
            assert daemon.servers == {}

    asyncio.run(run())
