"""Serves a scenario as a sonar on the network, along a route."""

import asyncio
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from oculus_driver.virtual_sonar.device import Identity
from oculus_driver.virtual_sonar.faults import Faults
from oculus_driver.virtual_sonar.playback import advertised_address
from oculus_driver.virtual_sonar.server import VirtualSonar
from sonar_sim.device.simulated_device import SimulatedDevice
from sonar_sim.effects.plan import AUTO, EffectSelection
from sonar_sim.geometry.trajectory import Route, RouteEnd
from sonar_sim.navigation.odometry_output import OdometryOutput, OdometrySender
from sonar_sim.scene.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ServeSettings:
    """Options of a served scenario.

    Attributes:
        host, port: address of the sonar; port 0 is any free one.
        status_to: destination of status messages.
        device_id: serial number.
        standby: send nothing until a client requests pings.
        ends: behaviour at the end, see `sonar_sim.geometry.trajectory.Route`.
        faults: faults of the sonar.
        outputs: destinations of the odometry.
        seed: seed of all random numbers.
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
    """A scenario in real time, during an `async with` block.

    Raises:
        SonarSimError, OculusError: a link cannot be opened; raised on entering.
        EffectError: an effect is unknown; raised at once.

    Attributes:
        sonar: the sonar, with its counters; its `finished` is set at the end of the route.
        route: route of the vehicle.
        outputs: outputs of the odometry.
    """

    def __init__(self, scenario: Scenario, settings: ServeSettings | None = None) -> None:
        settings = settings or ServeSettings()
        EffectSelection.read(settings.effects)  # report unknown names now, not at the first ping
        self.route = Route(scenario.trajectory, settings.ends)
        self.outputs = settings.outputs
        self._unix_offset_ns = time.time_ns() - time.monotonic_ns()
        self._began_ns = time.monotonic_ns()
        self._device = SimulatedDevice(
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
            self._device,
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
        """Return the time on the route."""
        return (time.monotonic_ns() - self._began_ns) / 1e9

    def unix_ns(self, route_s: float) -> int:
        """Return the Unix time of a time on the route."""
        return self._began_ns + self._unix_offset_ns + round(route_s * 1e9)

    async def __aenter__(self) -> Self:
        try:
            await self._sender.open()
            await self._device.warm_up()  # a client waits for pings, not for the scene
            await self.sonar.__aenter__()
        except BaseException:
            self._device.close()
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
