"""Who moves the first vehicle of a page: the scene's path, or a pilot's keys."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

from sonar_sim.geometry.driving import DriveCommand, DrivenBody
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.trajectory import Trajectory

UPDATE_S = 0.04
SIDE_SHARE, RISE_SHARE, TURN_RPS_PER_MPS = 0.6, 0.5, 0.8
"""Of the speed ahead: to the sides, up and down, and in turning."""

KEYS: Mapping[str, tuple[str, str, int]] = MappingProxyType(
    {
        "I": ("ahead", "ahead_mps", 1),
        "K": ("back", "ahead_mps", -1),
        "J": ("turn to port", "turn_rps", 1),
        "L": ("turn to starboard", "turn_rps", -1),
        "U": ("to port", "port_mps", 1),
        "O": ("to starboard", "port_mps", -1),
        "Y": ("up", "up_mps", 1),
        "H": ("down", "up_mps", -1),
        "space": ("stop", "", 0),
    }
)
"""What each key does: name, field of the command, and sense. The opposite key stops, then turns."""

_SHARES = {
    "ahead_mps": 1.0,
    "port_mps": SIDE_SHARE,
    "up_mps": RISE_SHARE,
    "turn_rps": TURN_RPS_PER_MPS,
}


class Helm:
    """Moves a vehicle along a path until a pilot takes over; the path waits meanwhile.

    Args:
        route: the path; at its end the vehicle does what the route does.
        path: gets the poses.
        clock: seconds on the live path.

    Attributes:
        mode: "path" or "keys".
        speed_mps: ahead, at a key.
    """

    def __init__(self, route: Trajectory, path: LivePath, clock: Callable[[], float]) -> None:
        self.mode: Literal["path", "keys"] = "path"
        self.speed_mps = 0.6
        self._route = route
        self._path = path
        self._clock = clock
        self._route_s = 0.0
        self._time_s = 0.0
        self._body = DrivenBody(route.pose(0.0))
        self._senses = dict.fromkeys(_SHARES, 0)

    @property
    def command(self) -> DriveCommand:
        """What the pilot asks for."""
        return replace(
            DriveCommand(),
            **{
                field: sense * _SHARES[field] * self.speed_mps
                for field, sense in self._senses.items()
            },
        )

    def press(self, key: str) -> None:
        """Take a key of `KEYS`; the first one takes over from the path."""
        _, field, sense = KEYS[key]
        if self.mode == "path":
            self.steer(mode="keys")
        if field:
            self._senses[field] = max(-1, min(1, self._senses[field] + sense))
        else:
            self._senses = dict.fromkeys(_SHARES, 0)

    def steer(self, mode: Literal["path", "keys"]) -> None:
        """Give the vehicle to the pilot, where it is, or back to the path, where that was left."""
        if mode == self.mode:
            return
        self.mode = mode
        self._senses = dict.fromkeys(_SHARES, 0)
        now_s = self._clock()
        if mode == "keys":
            self._body.place(self._path.pose(now_s))
        else:
            self._path.jump(now_s, self._route.pose(self._route_s))

    def advance(self, now_s: float) -> None:
        """Move the vehicle up to a time."""
        passed_s, self._time_s = max(0.0, now_s - self._time_s), now_s
        if passed_s == 0.0:
            return
        if self.mode == "path":
            self._route_s += passed_s
            route, at_s = self._route, self._route_s
            motion = route.velocity_mps(at_s), route.turn_rates_rps(at_s)
            self._path.update(now_s, route.pose(at_s), *motion)
        else:
            self._body.advance(passed_s, self.command)
            body = self._body
            self._path.update(now_s, body.pose, body.velocity_mps, body.turn_rates_rps)

    async def run(self) -> None:
        """Move it until cancelled."""
        while True:
            self.advance(self._clock())
            await asyncio.sleep(UPDATE_S)
