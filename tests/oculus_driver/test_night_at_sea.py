"""A night at sea, compressed: driver and played sonar on loopback, with everything going wrong.

All images are alike, so that a ping with flipped bits is known from a whole one.
"""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oculus_driver import Faults, FireSettings, LinkTimeouts, OculusSonar, PlaybackSonar
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.net

# `make soak` plays a whole night of 200 000 pings.
PINGS, LOOPS = 500, int(os.environ.get("NIGHT_LOOPS", "8"))
LIMIT_S = 60.0 + 2.0 * LOOPS
MS_NS = 1_000_000
QUICK = LinkTimeouts(back_off_ns=(5 * MS_NS,), send_gap_ns=MS_NS, keep_alive_ns=200 * MS_NS)
FAULTS = Faults(
    cut=0.005,
    flip=0.01,
    lose=0.005,
    garbage=0.01,
    stall=0.002,
    stall_s=0.02,
    restart=0.004,
    restart_ids=0.002,
    seed=7,
)


async def all_taken(sonar: OculusSonar) -> None:
    """Wait for a sign of life behind the last ping, and for the reader."""
    before = sonar.counters.messages.get(MessageId.DUMMY, 0)
    while (  # noqa: ASYNC110 - nothing reports dummies
        sonar.counters.messages.get(MessageId.DUMMY, 0) == before or sonar.counters.queued
    ):
        await asyncio.sleep(0.01)


def test_every_undamaged_ping_arrives_exactly_once(make_ping: Callable[..., bytes]) -> None:
    pings = [make_ping(ping_id=index, start_time=0.1 * index) for index in range(1, PINGS + 1)]
    sent: list[tuple[int, bool]] = []
    expected = np.arange(5 * 256, dtype=np.uint64).reshape(5, 256).astype(np.uint8)
    got: Counter[bool] = Counter()  # whether the image is whole
    arrived: Counter[int] = Counter()

    async def read(sonar: OculusSonar) -> None:
        async for ping in sonar.pings():
            whole_image = np.array_equal(ping.image, expected)
            got[whole_image] += 1
            arrived[ping.ping_id] += whole_image

    async def night() -> None:
        async with asyncio.timeout(LIMIT_S):
            async with PlaybackSonar(
                pings,
                loops=LOOPS,
                speed=None,
                faults=FAULTS,
                dummy_period_s=0.02,
                on_ping=lambda ping_id, whole: sent.append((ping_id, whole)),
            ) as played:
                settings = FireSettings(range_m=10.0)
                async with OculusSonar(
                    played.host, settings, port=played.port, times=QUICK
                ) as sonar:
                    reading = asyncio.create_task(read(sonar))
                    await played.finished.wait()
                    await all_taken(sonar)
                    reading.cancel()
                    await asyncio.gather(reading, return_exceptions=True)
                counters = sonar.counters
        assert len(asyncio.all_tasks()) == 1
        assert played.counters.cuts > 5
        assert played.counters.restarts > 5
        assert counters.connections >= played.counters.cuts + played.counters.restarts
        assert counters.pings == counters.taken + counters.dropped
        assert counters.taken == got.total()
        assert counters.dropped == 0

    asyncio.run(night())
    assert len(sent) == PINGS * LOOPS
    whole = Counter(ping_id for ping_id, undamaged in sent if undamaged)
    assert whole - arrived == Counter()
    damaged = Counter(ping_id for ping_id, undamaged in sent if not undamaged)
    # Bits may flip where nobody looks: the gap, the echo of the settings. Those of the id, 32 of
    # some 20 000, give a ping another one's name: less than one of 20 000 pings.
    renamed = (arrived - whole - damaged).total()
    assert renamed <= 3 + len(sent) // 20_000
