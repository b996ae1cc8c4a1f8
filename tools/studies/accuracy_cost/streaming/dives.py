"""Dives that the stream is measured on: simulated pings of a basin, and a link."""

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench import scene
from bench.inputs import Pings, load
from numpy.typing import NDArray
from sonar_sim import Simulator, SonarSettings

from mapperd.server.pacer import Pacer
from oculus_driver.encode import bearing_table_cdeg
from studies.accuracy_cost.study import StudyDive

__all__ = [
    "DIVES",
    "PING_S",
    "PLANS",
    "LinkRate",
    "SimulatedLink",
    "StreamPlan",
    "load_dive",
    "position_of",
    "prepare_dive",
]


MIN_IN_FLIGHT_BYTES = 3_000
"""Bytes: two packets."""


@dataclass(frozen=True, slots=True)
class LinkRate:
    """Bytes a second, and the delay of each direction."""

    rate: float
    delay_s: float


class SimulatedLink:
    """Moves messages, and reports to the pacer what becomes of them.

    Args:
        shape: of the link.
        pacer: of the connection; notified of each message before it is carried.

    Attributes:
        carried: bytes so far.
    """

    def __init__(self, shape: LinkRate, pacer: Pacer) -> None:
        self.carried = 0
        self._shape, self._pacer = shape, pacer
        self._waiting: deque[bytes] = deque()
        self._sending: deque[tuple[bytes, float]] = deque()
        self._acks: deque[tuple[float, int]] = deque()
        self._free_s = 0.0
        self._used = 0
        self._round_trip_s = 2 * shape.delay_s

    @property
    def unsent(self) -> int:
        """Bytes that wait before the wire."""
        return sum(map(len, self._waiting))

    def carry(self, message: bytes) -> None:
        """Take a message."""
        self.carried += len(message)
        self._waiting.append(message)

    def step(self, now_s: float) -> list[bytes]:
        """Let time pass; returns the messages that arrive."""
        self._send(now_s)
        arrived = []
        while self._sending and self._sending[0][1] <= now_s:
            message, at_s = self._sending.popleft()
            self._used += len(message)
            self._acks.append((at_s + self._shape.delay_s, self._used))
            arrived.append(message)
        min_s = 2 * self._shape.delay_s
        in_network = int(max(self._free_s - now_s + min_s, 0.0) * self._shape.rate)
        self._pacer.note_link(self.unsent, min_s, self._round_trip_s, in_network, self._shape.rate)
        while self._acks and self._acks[0][0] <= now_s:
            if not self._pacer.note_ack(self._acks.popleft()[1], now_s):
                raise AssertionError("more arrived than was sent")
        return arrived

    def _send(self, now_s: float) -> None:
        wire = max(2 * self._shape.rate * 2 * self._shape.delay_s, MIN_IN_FLIGHT_BYTES)
        while self._waiting:
            in_flight = max(self._free_s - now_s, 0.0) * self._shape.rate
            if in_flight > wire:
                return
            message = self._waiting.popleft()
            began_s = max(self._free_s, now_s)
            self._free_s = began_s + len(message) / self._shape.rate
            self._sending.append((message, self._free_s + self._shape.delay_s))
            waited_s = self._free_s - now_s + 2 * self._shape.delay_s
            self._round_trip_s += (waited_s - self._round_trip_s) / 8


PING_S = 0.2
RANGE_M, GAIN_PERCENT = 20.0, 50.0


@dataclass(frozen=True, slots=True)
class StreamPlan:
    """A dive, and the link over which its map is sent.

    Attributes:
        pings: five a second.
        joins: ping at which the client connects.
        beams, rows: of the sonar's images.
        link: to the client.
        voxel_m: of the map.
        judged_every: so many pings.
    """

    pings: int
    joins: int
    beams: int
    rows: int
    link: LinkRate
    voxel_m: float = 0.2
    judged_every: int = 5


WIDE = LinkRate(rate=1_000_000.0, delay_s=0.02)
RADIO = LinkRate(rate=32_000.0, delay_s=0.15)
PLANS = {
    "wide": StreamPlan(120, 30, 256, 250, WIDE),
    "radio": StreamPlan(120, 30, 256, 250, RADIO),
    "short": StreamPlan(24, 3, 64, 50, WIDE, 0.4, 2),
}
DIVES = (StudyDive("wide", 1), StudyDive("radio", 1), StudyDive("short", 2, quick=True))


def prepare_dive(dive: StudyDive, folder: Path) -> None:
    """Simulate the pings; a file that is there is whole."""
    path = _path(folder)
    if path.exists():
        return
    plan = PLANS[dive.name]
    row_m = RANGE_M / plan.rows
    sonar = SonarSettings(
        demanded_range_m=RANGE_M, base_row_m=row_m, gain_percent=GAIN_PERCENT, beams=plan.beams
    )
    simulator = Simulator(scene.basin(), sonar, dive.seed, threads=1)
    poses = scene.poses(30.0, plan.pings)
    images = [simulator.ping(pose, k).image for k, pose in enumerate(poses)]
    bearings_rad = np.radians(bearing_table_cdeg(sonar.beams, sonar.half_aperture_rad) / 100.0)
    map_T_sonar = np.tile(np.eye(4), (plan.pings, 1, 1))  # noqa: N806 frames are named
    map_T_sonar[:, :3, :3] = [pose.rotation for pose in poses]
    map_T_sonar[:, :3, 3] = [pose.position_m for pose in poses]
    made = np.stack(images).astype(np.uint8)
    Pings(made, bearings_rad, sonar.range_resolution_m, map_T_sonar).save(path)


def load_dive(folder: Path) -> Pings:
    """The prepared pings."""
    return load(_path(folder))


def position_of(pings: Pings, number: int) -> NDArray[np.float64]:
    """(3,) of the sonar."""
    return np.asarray(pings.map_T_sonar[number, :3, 3])


def _path(folder: Path) -> Path:
    return folder / "pings.npz"
