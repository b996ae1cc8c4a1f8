"""Serves a scenario as a sonar on the network, along a route."""

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self

from oculus_driver.virtual_sonar.device import Identity
from oculus_driver.virtual_sonar.faults import Faults
from oculus_driver.virtual_sonar.playback import advertised_address
from oculus_driver.virtual_sonar.server import VirtualSonar
from sonar_sim.device.simulated_device import SimulatedDevice
from sonar_sim.effects.plan import AUTO, EffectSelection
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.live_path import LivePath
from sonar_sim.geometry.trajectory import Route, RouteEnd, Trajectory
from sonar_sim.navigation.follow import PoseFollower
from sonar_sim.navigation.odometry_output import OdometryOutput, OdometrySender
from sonar_sim.scene.scenario import Scenario, with_bodies


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
        more_outputs: destinations of the odometry of further vehicles, by their names.
        follow: links that bring the pose of a vehicle, by its name, see
            `sonar_sim.navigation.follow.PoseFollower`; or live paths that the caller updates.
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
    more_outputs: Mapping[str, list[OdometryOutput]] = field(default_factory=dict)
    follow: Mapping[str, str | LivePath] = field(default_factory=dict)


class ServedScenario:
    """A scenario in real time, during an `async with` block, with all its sonars and vehicles.

    Further sonars have the next ports and serial numbers, in the scenario's order.

    Raises:
        SonarSimError, OculusError: a link cannot be opened; raised on entering.
        EffectError, SonarSimError: an effect, vehicle or link is unknown; raised at once.

    Attributes:
        sonar: the first sonar, with its counters; its `finished` is set at the end of the route.
        sonars: all of them.
        scenarios: of each sonar.
        routes: of the vehicles, by name.
        route: of the first one.
        outputs: outputs of its odometry.
        followers: links that bring poses, by the vehicle's name.
    """

    def __init__(self, scenario: Scenario, settings: ServeSettings | None = None) -> None:
        settings = settings or ServeSettings()
        EffectSelection.read(settings.effects)  # report unknown names now, not at the first ping
        self.scenarios = (scenario, *scenario.others)
        vehicles = {one.vehicle.name: one for one in reversed(self.scenarios)}
        for name in (*settings.follow, *settings.more_outputs):
            if name not in vehicles:
                known = ", ".join(reversed(vehicles))
                raise SonarSimError(f"no vehicle is called {name!r}; there are {known}")
        self.outputs = settings.outputs
        self._unix_offset_ns = time.time_ns() - time.monotonic_ns()
        self._began_ns = time.monotonic_ns()
        self.routes: dict[str, Trajectory] = {}
        self.followers: dict[str, PoseFollower] = {}
        for name, one in vehicles.items():
            self.routes[name] = self._route(one, settings)
        self.route = self.routes[scenario.vehicle.name]
        self._devices = [self._device(k, settings) for k in range(len(self.scenarios))]
        self.sonars = [
            VirtualSonar(
                device,
                host=settings.host,
                port=settings.port + k if settings.port else 0,
                speed=None,
                status_to=settings.status_to,
                faults=settings.faults,
            )
            for k, device in enumerate(self._devices)
        ]
        self.sonar = self.sonars[0]
        outputs = {scenario.vehicle.name: settings.outputs, **settings.more_outputs}
        self._senders = [
            OdometrySender(vehicles[name], self.routes[name], some, self.unix_ns, settings.seed)
            for name, some in outputs.items()
        ]
        self._stack = AsyncExitStack()
        self._sending: list[asyncio.Task[None]] = []

    def _route(self, scenario: Scenario, settings: ServeSettings) -> Trajectory:
        name = scenario.vehicle.name
        source = settings.follow.get(name)
        if source is None:
            return Route(scenario.trajectory, settings.ends)
        if isinstance(source, LivePath):
            return source
        path = LivePath(scenario.trajectory.pose(0.0))
        self.followers[name] = PoseFollower(source, path, scenario.vehicle, self.route_s)
        return path

    def _device(self, number: int, settings: ServeSettings) -> SimulatedDevice:
        """Build the sonar of a scenario; it sees the other vehicles."""
        one = self.scenarios[number]
        others = {
            other.vehicle.name: (other.vehicle, self.routes[other.vehicle.name])
            for other in self.scenarios
            if other.vehicle.name != one.vehicle.name
        }
        return SimulatedDevice(
            replace(one, scene=with_bodies(one.scene, others.values())),
            self.routes[one.vehicle.name],
            self.route_s,
            Identity(settings.device_id + number, address=advertised_address(settings.host)),
            standby=settings.standby,
            seed=settings.seed + number,
            effects=settings.effects,
            ignored_fire_version=settings.faults.ignored_fire_version,
        )

    def route_s(self) -> float:
        """Return the time on the routes."""
        return (time.monotonic_ns() - self._began_ns) / 1e9

    def unix_ns(self, route_s: float) -> int:
        """Return the Unix time of a time on the routes."""
        return self._began_ns + self._unix_offset_ns + round(route_s * 1e9)

    async def __aenter__(self) -> Self:
        async with AsyncExitStack() as stack:
            for device in self._devices:
                stack.callback(device.close)
            for sender in self._senders:
                stack.push_async_callback(sender.close)
                await sender.open()
            for device in self._devices:
                await device.warm_up()  # a client waits for pings, not for the scene
            for sonar in self.sonars:
                await stack.enter_async_context(sonar)
            self._began_ns = time.monotonic_ns()
            for follower in self.followers.values():
                await follower.open()
                stack.push_async_callback(follower.close)
            self._sending = [
                asyncio.create_task(sender.run(self.route_s)) for sender in self._senders
            ]
            self._stack = stack.pop_all()
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for task in self._sending:
            task.cancel()
        await asyncio.gather(*self._sending, return_exceptions=True)
        await self._stack.__aexit__(kind, error, trace)

    async def run(self) -> None:
        """Wait for the end of the first vehicle's route.

        Raises:
            Exception: what ended the sending of odometry.
        """
        if self._sending:
            await self._sending[0]
        await asyncio.sleep(self.route.duration_s - self.route_s())
