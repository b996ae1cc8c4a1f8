"""Robots, localization, and events come over a real server as the daemon knows them."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.client import MapClient
from mapperd.client.changes import ClientChange
from mapperd.client.validation import floats_of
from mapperd.events import Severity
from mapperd.localization.status import LocalizationSnapshot
from mapperd.server.listeners import open_unix_listener
from mapperd.server.state_feed import StateFeed
from mapperd.server.stream_server import StreamServer
from mapperd.wire.messages import EventMessage, LocalizationMessage, RobotsMessage, Want
from tests.mapperd.localization.believed import snapshot as believed
from tests.mapperd.server.watched import PlainSource
from tests.support.control_server import FakeDaemon
from tests.support.waiting import run

pytestmark = pytest.mark.net


@dataclass
class Known:
    """As a `StatusSnapshot`, as far as the feed reads them."""

    odometry: dict[str, Any] = field(default_factory=lambda: {"source": "odometry"})
    robots: list[dict[str, Any]] = field(default_factory=list)
    localization: LocalizationSnapshot | None = None


@dataclass
class SentState:
    """A daemon, its client, and the changes that the client got, of the kinds it waits for."""

    daemon: FakeDaemon
    known: Known
    client: MapClient
    changes: AsyncIterator[ClientChange]

    async def next(self, is_it: Callable[[Any], bool]) -> Any:
        async for change in self.changes:
            if is_it(change):
                return change
        raise AssertionError("the changes came to their end")


@contextlib.asynccontextmanager
async def running_client(folder: Path, *wants: Want) -> AsyncIterator[SentState]:
    daemon, known = FakeDaemon(), Known()
    feed = StateFeed(daemon, lambda: known, 100)  # type: ignore[arg-type,return-value]
    path = folder / "map.sock"
    async with (
        StreamServer(daemon, [open_unix_listener(path, 0o600)], feed, PlainSource()),
        MapClient(str(path), wants=wants) as client,
    ):
        while client.link.state != "connected":  # noqa: ASYNC110 of another task
            await asyncio.sleep(0)
        yield SentState(daemon, known, client, client.changes())
        assert client.link.faults == 0


def test_robots_come_and_go(short: Path) -> None:
    async def work() -> None:
        async with running_client(short, "robots") as sent:
            sent.known.robots = [{"t_s": 2.5, "position_m": [1.0, 2.0, 3.0]}]
            first = await sent.next(lambda one: isinstance(one, RobotsMessage) and bool(one.seen))
            assert first.seen == [(2_500_000_000, 1.0, 2.0, 3.0)]
            assert sent.client.robots == first
            sent.known.robots = []
            await sent.next(lambda one: isinstance(one, RobotsMessage) and not one.seen)
            assert sent.client.robots == RobotsMessage(seen=[])

    run(work())


def test_localization_is_reported_with_its_cloud_and_its_scan(short: Path) -> None:
    async def work() -> None:
        async with running_client(short, "localization") as sent:
            sent.known.localization = snapshot = believed(0.2)
            first = await sent.next(lambda one: isinstance(one, LocalizationMessage))
            assert first.report["map"] == "tank.yaml"
            assert (first.report["state"], first.report["elsewhere"]) == ("ambiguous", 0.2)
            assert first.report["x_m"] == 1.0
            np.testing.assert_array_equal(
                floats_of(first.particles, 4), snapshot.particles.astype(np.float32)
            )
            assert floats_of(first.scan, 3).tolist() == [[5.0, 2.0, 0.0]]  # the other is no place
            sent.known.localization = believed(None, state="waiting for a pose", scan_points_m=None)
            second = await sent.next(lambda one: isinstance(one, LocalizationMessage))
            assert (second.report["state"], second.scan) == ("waiting for a pose", b"")

    run(work())


def test_events_are_reported_once_each_and_again_after_a_break(short: Path) -> None:
    async def work() -> None:
        async with running_client(short, "events") as sent:
            events = sent.daemon.events

            async def heard(number: int) -> list[tuple[int, str, int]]:
                found = [
                    await sent.next(lambda one: isinstance(one, EventMessage))
                    for _ in range(number)
                ]
                return [(one.event["number"], one.event["code"], one.lost) for one in found]

            last = events.last
            for n in range(3):
                events.add(Severity.WARNING, f"code_{n}", "text", range_m=0.5)
            assert await heard(3) == [(last + n + 1, f"code_{n}", 0) for n in range(3)]
            assert sent.client.link.connects == 1
            assert sent.client._writer is not None
            sent.client._writer.transport.abort()
            for n in range(2):
                events.add(Severity.ERROR, f"away_{n}", "text")
            assert await heard(2) == [(last + n + 4, f"away_{n}", 0) for n in range(2)]
            assert sent.client.link.connects == 2

    run(work())
