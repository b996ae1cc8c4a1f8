"""`mapperd` without a recording: maps what the network brings until it is told to stop."""

import asyncio
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mapperd.export.summary import summary_of
from mapperd.links.link import Link
from mapperd.links.state import LinkStatus as OdometryStatus
from mapperd.live import Live
from mapperd.mapping import SonarMap
from mapperd.pairing import FixedPose, OdometryPoses
from oculus_driver.link_state import LinkStatus

__all__ = ["map_live"]

TELL_S = 10.0
"""Between lines that say how it goes."""

STOPS = (signal.SIGINT, signal.SIGTERM)

Say = Callable[[str], None]


def map_live(
    sonar_map: SonarMap,
    poses: FixedPose | OdometryPoses,
    duration_s: float | None,
    say: Say,
) -> dict[str, Any]:
    """Map until SIGINT, SIGTERM or the end of the time; returns the summary.

    Args:
        sonar_map: the map; its settings say where the links are.
        poses: fixed, or from the vehicle's odometry.
        duration_s: seconds to map; None is until somebody stops it.
        say: is told, in one line each, what the links do and how it goes.

    Raises:
        LiveError: the odometry's address cannot be listened on.
        OculusError: the sonar cannot be looked for, or not be asked for what the settings say.
    """
    return asyncio.run(_Session(sonar_map, poses, say).run(duration_s))


@dataclass(frozen=True, slots=True)
class _Session:
    sonar_map: SonarMap
    poses: FixedPose | OdometryPoses
    say: Say

    async def run(self, duration_s: float | None) -> dict[str, Any]:
        live = Live(self.sonar_map, self.poses, self._tell_state, self._tell_link)
        began_s = time.perf_counter()
        telling = asyncio.create_task(self._tell(live))
        try:
            await live.run(_told_to_stop(duration_s))
        finally:
            telling.cancel()
        wall_s = time.perf_counter() - began_s
        source = {"live": _live_facts(live, self.sonar_map)}
        return summary_of(source, self.sonar_map, self.poses, live.stepping.counters, wall_s)

    def _tell_state(self, status: LinkStatus) -> None:
        self.say(f"sonar: {status.state}: {status.reason}")

    def _tell_link(self, name: str, status: OdometryStatus) -> None:
        self.say(f"{name}: {status.phase}: {status.reason}")

    async def _tell(self, live: Live) -> None:
        """Say every now and then how it goes, and that odometry is missing if it is."""
        while True:
            heard = self._records()
            await asyncio.sleep(TELL_S)
            counters = live.stepping.counters
            dropped = counters.pings_dropped.total()
            self.say(
                f"{counters.pings_mapped} pings mapped, {dropped} dropped, sonar {live.link.state}"
            )
            if self._records() == heard and isinstance(self.poses, OdometryPoses):
                self.say(f"no odometry for {TELL_S:g} s; see `mapperd doctor`")

    def _records(self) -> int:
        poses = self.poses
        return poses.ignored if isinstance(poses, FixedPose) else poses.odometry.received


async def _told_to_stop(duration_s: float | None) -> None:
    """Wait for a signal or the end of the time; a second signal then ends the program."""
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    for number in STOPS:
        loop.add_signal_handler(number, stopped.set)
    try:
        async with asyncio.timeout(duration_s):
            await stopped.wait()
    except TimeoutError:
        pass
    finally:
        for number in STOPS:
            loop.remove_signal_handler(number)


def _live_facts(live: Live, sonar_map: SonarMap) -> dict[str, Any]:
    device = sonar_map.config.device
    return {
        "sonar": f"{live.link.address or device.address or 'found by status'}:{device.port}",
        "odometry": {link.name: _link_facts(link) for link in live.links},
        "recording": live.recorder.status(),
        "pings_placed_by": dict(sorted(live.sonar_clock.placed.items())),
        "sonar_restarts": live.sonar_clock.restarts,
    }


def _link_facts(link: Link) -> dict[str, Any]:
    status = link.status
    return {
        "link": str(link.address),
        "state": str(status.phase),
        "reason": status.reason,
        "bytes": status.bytes_received,
        "opened": status.opened,
        "losses": status.losses,
    }
