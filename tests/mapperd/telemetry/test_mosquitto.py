"""Telemetry against Eclipse Mosquitto."""

import asyncio
import contextlib
import json
import shutil
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.waiting import until

pytest.importorskip("aiomqtt", reason="aiomqtt is not installed")

from aiomqtt import Client, MqttError

from mapperd.events import Severity
from mapperd.telemetry import broker
from mapperd.telemetry import telemetry as telemetry_module
from mapperd.telemetry.telemetry import Phase, Telemetry
from tests.mapperd.telemetry.conftest import POSE, ROBOT, ROOT, FakeVehicle
from tests.support.peers.mosquitto import Cable, mosquitto_path, running_mosquitto
from tests.support.process import free_tcp_port

pytestmark = [
    pytest.mark.net,
    pytest.mark.skipif(
        mosquitto_path() is None, reason="Mosquitto is not installed: apt install mosquitto"
    ),
]

LONG_S = 60.0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telemetry_module, "RETRY_DELAY_S", 0.05)
    monkeypatch.setattr(telemetry_module, "MAX_RETRY_DELAY_S", 0.1)


class Listener:
    """Someone on shore, who hears everything below the root.

    Attributes:
        heard: topic to payloads, oldest first.
        kept: topic to what was retained when we came.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self.heard: dict[str, list[bytes]] = {}
        self.kept: dict[str, bytes] = {}

    async def listen(self) -> None:
        async for message in self._client.messages:
            topic = str(message.topic).removeprefix(f"{ROOT}/")
            assert isinstance(message.payload, bytes)
            self.heard.setdefault(topic, []).append(message.payload)
            if message.retain:
                self.kept[topic] = message.payload

    async def hears(self, topic: str, payload: bytes | None = None) -> Any:
        """Wait for a message, and for this payload if one is named; takes it out."""
        wanted: list[bytes] = []

        def found() -> bool:
            wanted[:] = [
                one for one in self.heard.get(topic, []) if payload is None or one == payload
            ]
            return bool(wanted)

        await until(found)
        self.heard[topic].remove(wanted[0])
        return wanted[0] if topic == "status" else json.loads(wanted[0])

    async def publish(self, topic: str, payload: object, *, retain: bool = False) -> None:
        await self._client.publish(f"{ROOT}/{topic}", json.dumps(payload), qos=1, retain=retain)


@contextlib.asynccontextmanager
async def listening(port: int, **login: Any) -> AsyncIterator[Listener]:
    async with Client("127.0.0.1", port, **login) as client:
        listener = Listener(client)
        await client.subscribe(f"{ROOT}/#", qos=1)
        task = asyncio.create_task(listener.listen())
        try:
            yield listener
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


@contextlib.asynccontextmanager
async def running_telemetry(daemon: FakeVehicle, **more: Any) -> AsyncIterator[Telemetry]:
    telemetry = Telemetry(daemon, chance=lambda: 0.5, **({"environment": {}} | more))
    task = asyncio.create_task(telemetry.run())
    try:
        yield telemetry
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@pytest.fixture
def port(tmp_path: Path) -> Any:
    number = free_tcp_port()
    with running_mosquitto(tmp_path, number):
        yield number


def test_everything_is_reported_and_the_end_too(port: int) -> None:
    daemon = FakeVehicle({"port": port})
    daemon.pose, daemon.robots = POSE, [ROBOT]
    daemon.events.add(Severity.NOTICE, "started", "the daemon has started")

    async def run() -> None:
        async with listening(port) as shore:
            async with running_telemetry(daemon, folders=(Path("/"),)) as telemetry:
                await shore.hears("status", b"online")
                assert (await shore.hears("event"))["code"] == "started"
                assert (await shore.hears("event"))["code"] == "mqtt_link"
                assert (await shore.hears("pose"))["position_m"] == [1.0, 2.0, -3.0]
                assert (await shore.hears("sonar"))["pings_dropped"] == {"no_pose": 1}
                assert (await shore.hears("map"))["revision"] == 3
                health = await shore.hears("health")
                assert health["memory_bytes"] > 1e6
                assert health["disk_free_bytes"]["/"] > 0
                assert (await shore.hears("sonar_robot_detections"))["robots"] == [ROBOT]
                assert telemetry.phase is Phase.CONNECTED
                daemon.events.add(Severity.NOTICE, "ending", "the daemon ends")
            await shore.hears("status", b"offline")
            codes = [json.loads(one)["code"] for one in shore.heard["event"]]
            assert codes == ["ending"]  # published before the end
        async with listening(port) as late:
            await late.hears("config/filtering.min_range")
            await until(lambda: {"status", "state", "sonar", "map", "tf"} <= set(late.kept))
            assert late.kept["status"] == b"offline"
            assert json.loads(late.kept["state"])["versions"] == {
                "mapperd": "1.2.3",
                "telemetry": 1,
            }
            assert not {"pose", "health", "event"} & set(late.kept)

    asyncio.run(run())


def test_a_broken_link_is_offline_and_later_reports_missed_events(port: int) -> None:
    async def run() -> None:
        async with Cable(port) as cable, listening(port) as shore:
            daemon = FakeVehicle({"port": cable.port})
            async with running_telemetry(daemon) as telemetry:
                await shore.hears("status", b"online")
                await until(lambda: telemetry.phase is Phase.CONNECTED)
                cable.cut()
                await shore.hears("status", b"offline")  # the will
                daemon.events.add(Severity.WARNING, "leak", "water comes in")
                await shore.hears("status", b"online")
                await until(
                    lambda: any(b"water comes in" in one for one in shore.heard.get("event", []))
                )
                assert telemetry.counts["connected"] >= 2
                assert telemetry.counts["lost"] >= 1
            await shore.hears("status", b"offline")

    asyncio.run(run())


def test_a_jammed_cable_costs_telemetry_and_no_event(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broker, "TIMEOUT_S", 1.0)

    async def run() -> None:
        async with Cable(port) as cable, listening(port) as shore:
            daemon = FakeVehicle({"port": cable.port, "queue": 10})
            async with running_telemetry(daemon) as telemetry:
                await shore.hears("status", b"online")
                cable.jammed = True
                for k in range(30):
                    daemon.events.add(Severity.NOTICE, "jammed", str(k))
                await until(lambda: telemetry.counts["lost"] >= 1)
                cable.jammed = False
                cable.cut()
                numbers: set[str] = set()
                while numbers < {str(k) for k in range(30)}:
                    event = await shore.hears("event")
                    numbers |= {event["text"]} if event["code"] == "jammed" else set()
                assert telemetry.status()["dropped"].get("event", 0) == 0
                assert telemetry.status()["queue"] <= 10 + 200

    asyncio.run(run())


def test_a_broker_that_starts_again_has_all_that_is_kept(tmp_path: Path) -> None:
    port = free_tcp_port()
    daemon = FakeVehicle({"port": port})

    async def run() -> None:
        async with running_telemetry(daemon) as telemetry:
            await until(lambda: telemetry.counts["lost"] >= 2)  # there is no broker yet
            for _ in range(2):
                connected = telemetry.counts["connected"]
                with running_mosquitto(tmp_path, port):
                    await until(lambda: telemetry.counts["connected"] > connected)  # noqa: B023 now
                    async with listening(port) as shore:
                        await shore.hears("config/mqtt.vehicle", b'"rov-1"')
                        await shore.hears("status", b"online")
                await until(lambda: telemetry.phase is not Phase.CONNECTED)

    asyncio.run(run())


def test_commands_are_obeyed_where_they_are_allowed(port: int) -> None:
    daemon = FakeVehicle({"port": port, "commands": True})

    async def run() -> None:
        async with listening(port) as shore:
            await shore.publish("cmd/reset", {"id": "old"}, retain=True)
            async with running_telemetry(daemon) as telemetry:
                await shore.hears("status", b"online")
                await shore.publish("cmd/save", {"id": "a", "name": "map.bt"})
                answer = await shore.hears("cmd/save/result")
                assert (answer["id"], answer["ok"]) == ("a", True)
                await shore.publish("config/filtering.min_range/set", {"id": 2, "value": 1.5})
                answer = await shore.hears("config/filtering.min_range/result")
                assert (answer["id"], answer["ok"], answer["value"]) == (2, True, 1.5)
                await shore.hears("config/filtering.min_range", b"1.5")
                await shore.publish("config/octree.voxel_resolution/set", 1)
                answer = await shore.hears("config/octree.voxel_resolution/result")
                assert (answer["ok"], answer["reason"]) == (False, "refused")
                counts = telemetry.status()["requests"]
        assert counts == {"retained": 1, "done": 2, "refused": 1}

    asyncio.run(run())
    assert daemon.asked == [("save", "map.bt", "mqtt")]


def test_commands_are_not_heard_where_they_are_not_allowed(port: int) -> None:
    daemon = FakeVehicle({"port": port})

    async def run() -> None:
        async with listening(port) as shore, running_telemetry(daemon) as telemetry:
            await shore.hears("status", b"online")
            await shore.publish("cmd/reset", {"id": 1})
            await shore.publish("config/filtering.min_range/set", 3)
            daemon.settings.apply({"filtering.min_range": 1.0}, "x")
            await shore.hears("config/filtering.min_range", b"1.0")
            assert telemetry.status()["requests"] == {}

    asyncio.run(run())
    assert daemon.asked == []
    assert daemon.settings.current.filtering.min_range == 1.0


def test_oversized_and_flooding_senders_do_no_harm(port: int) -> None:
    daemon = FakeVehicle({"port": port, "commands": True})

    async def run() -> None:
        async with listening(port) as shore, running_telemetry(daemon) as telemetry:
            await shore.hears("status", b"online")
            async with Client("127.0.0.1", port) as other:
                await other.publish(f"{ROOT}/cmd/save", b"x" * 1_000_000, qos=1)
                for k in range(500):
                    await other.publish(f"{ROOT}/cmd/snapshot", b'{"id": %d}' % k)
            assert (await shore.hears("cmd/save/result"))["reason"] == "bad_request"
            await until(lambda: telemetry.status()["requests"].get("done", 0) > 0)
            before = telemetry.counts["published"]
            await until(lambda: telemetry.counts["published"] > before + 10)
            assert telemetry.counts["lost"] == 0

    asyncio.run(run())


def test_a_password_is_asked_for_and_wrong_ones_are_a_reason(tmp_path: Path) -> None:
    tool = shutil.which("mosquitto_passwd")
    if tool is None:
        pytest.skip("mosquitto_passwd is not installed")
    users, secret, port = tmp_path / "users", tmp_path / "mqtt-password", free_tcp_port()
    subprocess.run([tool, "-b", "-c", str(users), "rov", "right"], check=True)  # noqa: S603 ours
    secret.write_text("wrong\n", encoding="utf-8")
    daemon = FakeVehicle({"port": port, "username": "rov"})

    async def run() -> None:
        environment = {"CREDENTIALS_DIRECTORY": str(tmp_path)}
        async with running_telemetry(daemon, environment=environment) as telemetry:
            await until(lambda: telemetry.counts["lost"] >= 2)
            assert "not authori" in telemetry.reason.lower()
            secret.write_text("right\n", encoding="utf-8")  # read again at every attempt
            await until(lambda: telemetry.counts["connected"] == 1)

    lines = (f"password_file {users}", "allow_anonymous false")
    with running_mosquitto(tmp_path, port, *lines):
        asyncio.run(run())


# paho leaves the socket of a refused certificate to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_tls_is_checked(tmp_path: Path) -> None:
    tool = shutil.which("openssl")
    if tool is None:
        pytest.skip("openssl is not installed")
    key, certificate, port = tmp_path / "key.pem", tmp_path / "cert.pem", free_tcp_port()
    words = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    files = ["-keyout", str(key), "-out", str(certificate), "-days", "2"]
    subprocess.run([tool, *words, *names, *files], check=True, capture_output=True)  # noqa: S603 ours
    lines = ("allow_anonymous true", f"certfile {certificate}", f"keyfile {key}")
    trusted = FakeVehicle({"port": port, "tls": True, "ca_file": str(certificate)})
    unknown = FakeVehicle({"port": port, "tls": True})

    async def run() -> None:
        async with running_telemetry(trusted) as telemetry:
            await until(lambda: telemetry.counts["connected"] == 1)
        async with running_telemetry(unknown) as telemetry:
            await until(lambda: telemetry.counts["lost"] >= 1)
            assert telemetry.counts["connected"] == 0
            assert "certificate" in telemetry.reason.lower()

    with running_mosquitto(tmp_path, port, *lines):
        asyncio.run(run())


def test_two_of_one_name_do_not_stop_the_listener(port: int) -> None:
    """A broker has one client of a name at a time; both come back, nobody falls over."""
    daemon = FakeVehicle({"port": port})

    async def run() -> None:
        async with running_telemetry(daemon) as one:
            await until(lambda: one.counts["connected"] >= 1)
            with contextlib.suppress(MqttError):
                async with Client("127.0.0.1", port, identifier="rov-1-mapper"):
                    await until(lambda: one.counts["lost"] >= 1)
            await until(lambda: one.phase is Phase.CONNECTED)

    asyncio.run(run())
