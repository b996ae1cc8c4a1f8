"""Serve a scenario as a sonar on the network, along a route."""

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from oculus_driver.errors import OculusError
from oculus_driver.virtual_sonar.device import Identity
from oculus_driver.virtual_sonar.faults import Faults
from oculus_driver.virtual_sonar.playback import advertised_address
from oculus_driver.virtual_sonar.server import VirtualSonar
from sonar_sim.device.simulated_device import SimulatedDevice
from sonar_sim.effects.plan import AUTO, EffectSelection
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.pose import FramePose
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.navigation.odometry_output import OdometryOutput, OdometrySender
from sonar_sim.scene.scenario import Scenario

RouteEnd = Literal["stop", "stay", "back"]
ROUTE_ENDS: tuple[RouteEnd, ...] = ("stop", "stay", "back")
DAY_S = 86_400.0


class Route(Trajectory):
    """A trajectory, and what comes after it.

    Args:
        trajectory: the way there.
        ends: "stop" ends with it; "stay" keeps the last pose; "back" drives the same way back,
            stern first, and there again.

    Attributes:
        duration_s: of the whole; a day where it does not stop.
    """

    def __init__(self, trajectory: Trajectory, ends: RouteEnd) -> None:
        self._there = trajectory
        self._ends = ends
        self.duration_s = trajectory.duration_s if ends == "stop" else DAY_S

    def pose(self, time_s: float) -> FramePose:
        """The base in the map frame."""
        return self._there.pose(self._place(time_s)[0])

    def velocity_mps(self, time_s: float) -> NDArray[np.float64]:
        """Velocity in the body frame, (3,)."""
        place_s, sense = self._place(time_s)
        velocity: NDArray[np.float64] = sense * self._there.velocity_mps(place_s)
        return velocity

    def turn_rates_rps(self, time_s: float) -> NDArray[np.float64]:
        """Angular velocity in the body frame, rad/s, (3,)."""
        place_s, sense = self._place(time_s)
        rates: NDArray[np.float64] = sense * self._there.turn_rates_rps(place_s)
        return rates

    def _place(self, time_s: float) -> tuple[float, float]:
        """Time on the trajectory, and how fast and which way it passes: 1, 0 or -1."""
        length_s = self._there.duration_s
        if self._ends != "back" or length_s <= 0.0:
            inside = time_s < length_s
            return min(time_s, length_s), 1.0 if inside else 0.0
        turns, rest_s = divmod(time_s, length_s)
        return (length_s - rest_s, -1.0) if int(turns) % 2 else (rest_s, 1.0)


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """How a scenario is served.

    Attributes:
        host, port: where the sonar listens; port 0 is any free one.
        status_to: where its statuses go.
        device_id: serial number.
        standby: be silent until a client asks for pings.
        ends: what comes after the trajectory, see `sonar_sim.device.server.Route`.
        faults: how the sonar misbehaves.
        outputs: where the odometry goes.
        seed: of all random numbers.
        effects: as for `sonar_sim.Simulator`.
    """

    host: str = "127.0.0.1"
    port: int = 0
    status_to: Sequence[tuple[str, int]] = ()
    device_id: int = 750
    standby: bool = False
    ends: RouteEnd = "back"
    faults: Faults = field(default_factory=Faults)
    outputs: list[OdometryOutput] = field(default_factory=list)
    seed: int = 0
    effects: str = AUTO


class ServedScenario:
    """A scenario in real time, for the time of an `async with` block.

    Raises:
        SonarSimError, OculusError: a link cannot be opened; raised on entering.
        EffectError: no such effect; raised at once.

    Attributes:
        sonar: the sonar, with its counters; its `finished` is set at the end of the route.
        route: of the vehicle.
        outputs: of the odometry.
    """

    def __init__(self, scenario: Scenario, settings: ServeSettings | None = None) -> None:
        settings = settings or ServeSettings()
        EffectSelection.read(settings.effects)  # report a wrong name now, not at the first ping
        self.route = Route(scenario.trajectory, settings.ends)
        self.outputs = settings.outputs
        self._unix_offset_ns = time.time_ns() - time.monotonic_ns()
        self._began_ns = time.monotonic_ns()
        device = SimulatedDevice(
            scenario,
            self.route,
            self.route_s,
            Identity(settings.device_id, address=advertised_address(settings.host)),
            standby=settings.standby,
            seed=settings.seed,
            effects=settings.effects,
            ignored_fire_version=settings.faults.ignored_fire_version,
        )
        self.sonar = VirtualSonar(
            device,
            host=settings.host,
            port=settings.port,
            speed=None,
            status_to=settings.status_to,
            faults=settings.faults,
        )
        self._sender = OdometrySender(
            scenario, self.route, settings.outputs, self.unix_ns, settings.seed
        )
        self._sending: asyncio.Task[None] | None = None

    def route_s(self) -> float:
        """Time on the route."""
        return (time.monotonic_ns() - self._began_ns) / 1e9

    def unix_ns(self, route_s: float) -> int:
        """Unix time of a time on the route."""
        return self._began_ns + self._unix_offset_ns + round(route_s * 1e9)

    async def __aenter__(self) -> Self:
        try:
            await self._sender.open()
            await self.sonar.__aenter__()
        except (SonarSimError, OculusError):
            await self._sender.close()
            raise
        self._began_ns = time.monotonic_ns()
        self._sending = asyncio.create_task(self._sender.run(self.route_s))
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._sending is not None:
            self._sending.cancel()
            with suppress(asyncio.CancelledError):
                await self._sending
        await self._sender.close()
        await self.sonar.__aexit__(kind, error, trace)

    async def run(self) -> None:
        """Wait for the end of the route."""
        if self._sending is not None:
            await self._sending
        await asyncio.sleep(self.route.duration_s - self.route_s())
