"""Several vehicles and sonars in one scene, in steps of time: for simulators and loops of learning.

Nothing happens between two steps: the time is the caller's.
"""

import math
import zlib
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.plan import AUTO, Choice, EffectSelection
from sonar_sim.errors import SonarSimError
from sonar_sim.geometry.driving import DriveCommand, DrivenBody
from sonar_sim.geometry.live_path import KEPT_S, LivePath
from sonar_sim.geometry.pose import FramePose, Mounting, require_finite, rotation_vector
from sonar_sim.geometry.trajectory import Route, Trajectory
from sonar_sim.scene.scenario import Scenario, motion_on, with_bodies
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.vehicle import Vehicle
from sonar_sim.simulator import SimulatedPing, Simulator

EARLY_S = 1e-9
MAX_STEP_S = KEPT_S
"""Of which vehicles remember their paths."""


@dataclass(frozen=True, slots=True, eq=False)
class WorldPing:
    """A ping of one sonar.

    Attributes:
        vehicle, sonar: their names.
        ping_id: counts the sonar's pings, from 0.
        time_s: of the transmission, on the world's clock.
        map_T_sonar: then.
        ping: what it gives.
    """

    vehicle: str
    sonar: str
    ping_id: int
    time_s: float
    map_T_sonar: FramePose  # noqa: N815 frames are named
    ping: SimulatedPing


class WorldSonar:
    """A sonar on a vehicle of a world; `WorldVehicle.add_sonar` makes it.

    Attributes:
        name: unlike others of its vehicle.
        settings, mounting: of it.
        rate_hz: of its pings, at most what the sound's travel allows; 0 pings on demand alone.
    """

    def __init__(
        self,
        world: "World",
        vehicle: "WorldVehicle",
        name: str,
        mounted: tuple[SonarSettings, Mounting],
        rate_hz: float,
    ) -> None:
        self.name = name
        self.settings, self.mounting = settings, _ = mounted
        speed_mps = world.scene.water.speed_of_sound_mps
        self.rate_hz = min(rate_hz, speed_mps / (2.0 * settings.range_m))
        self._world = world
        self._vehicle = vehicle
        self._begun_s = world.time_s
        self._due = 1
        self._pings = 0

    @property
    def due_s(self) -> float:
        """When it pings next; never if its rate is 0."""
        return self._begun_s + self._due / self.rate_hz if self.rate_hz > 0.0 else math.inf

    def ping(self, *, truth: bool = False) -> WorldPing:
        """Ping now, besides its rate.

        Args:
            truth: whether to work out what rays and pixels show.
        """
        return self._ping_at(self._world.time_s, truth=truth)

    def due_ping(self) -> WorldPing:
        """Ping at `due_s`, which the world's clock has reached."""
        time_s = self.due_s
        self._due += 1
        return self._ping_at(time_s)

    def _ping_at(self, time_s: float, *, truth: bool = False) -> WorldPing:
        pose, motion = motion_on(self._vehicle.path, self.mounting, time_s)
        simulator = self._world.simulator(self._vehicle, self)
        ping_id, self._pings = self._pings, self._pings + 1
        ping = simulator.ping(pose, ping_id, time_s, motion, truth=truth)
        return WorldPing(self._vehicle.name, self.name, ping_id, time_s, pose, ping)


class WorldVehicle:
    """A vehicle of a world; `World.add_vehicle` makes it.

    It stands until it is told to move: by `drive`, `move_to` or `follow`, the last of which counts.

    Attributes:
        name: unlike others of the world.
        vehicle: its size, which sonars of other vehicles see.
        path: where it has been, on the world's clock.
        sonars: by name.
    """

    def __init__(self, world: "World", vehicle: Vehicle, pose: FramePose) -> None:
        self.name = vehicle.name
        self.vehicle = vehicle
        self.path = LivePath(pose)
        self.path.jump(world.time_s, pose)
        self.sonars: dict[str, WorldSonar] = {}
        self._world = world
        self._body = DrivenBody(pose)
        self._command: DriveCommand | None = None
        self._goal: FramePose | None = None
        self._followed: tuple[Trajectory, float] | None = None

    @property
    def pose(self) -> FramePose:
        """The base in the map, now."""
        return self.path.pose(self._world.time_s)

    @property
    def velocity_mps(self) -> NDArray[np.float64]:
        """Velocity in the body frame, now, (3,)."""
        return self.path.velocity_mps(self._world.time_s)

    def add_sonar(
        self,
        name: str,
        settings: SonarSettings | None = None,
        mounting: Mounting | None = None,
        rate_hz: float = 5.0,
    ) -> WorldSonar:
        """Mount a sonar; its first ping is one period from now.

        Args:
            name: unlike others of the vehicle.
            settings: None is an M750d in its low band at 10 m.
            mounting: None looks ahead from the vehicle's middle.
            rate_hz: of its pings; 0 pings on demand alone.

        Raises:
            SonarSimError: the name is taken, or the rate is none.
        """
        if name in self.sonars:
            raise SonarSimError(f"vehicle {self.name!r} already has a sonar {name!r}")
        if not 0.0 <= rate_hz < math.inf:
            raise SonarSimError(f"sonar {name!r}: {rate_hz} Hz is no rate of pings")
        ahead = mounting or Mounting((0.0, 0.0, 0.0), pitch_deg=0.0)
        mounted = settings or SonarSettings(), ahead
        made = WorldSonar(self._world, self, name, mounted, rate_hz)
        self.sonars[name] = made
        return made

    def drive(self, command: DriveCommand) -> None:
        """Follow commanded velocities from now on, level, with the lag of a small ROV."""
        if self._command is None:
            self._body.place(self.pose)
            self._body.velocity_mps = self.velocity_mps
            self._body.turn_rates_rps = self.path.turn_rates_rps(self._world.time_s)
        self._command, self._goal, self._followed = command, None, None

    def move_to(self, pose: FramePose) -> None:
        """Move evenly during the next step, and be at a pose at its end: another simulator's.

        Raises:
            SonarSimError: the pose is not finite.
        """
        require_finite(pose)
        self._command, self._goal, self._followed = None, pose, None

    def follow(self, path: Trajectory) -> None:
        """Go along a path, whose time 0 is now."""
        self._command, self._goal = None, None
        self._followed = path, self._world.time_s

    def place(self, pose: FramePose) -> None:
        """Be somewhere else at once, at rest.

        Raises:
            SonarSimError: the pose is not finite.
        """
        require_finite(pose)
        self._command, self._goal, self._followed = None, None, None
        self.path.jump(self._world.time_s, pose)

    def advance(self, start_s: float, end_s: float) -> None:
        """Move from one time to another; the world does this."""
        if self._followed is not None:
            path, zero_s = self._followed
            for time_s in _times(start_s, end_s):
                on_s = time_s - zero_s
                motion = path.velocity_mps(on_s), path.turn_rates_rps(on_s)
                self.path.update(time_s, path.pose(on_s), *motion)
        elif self._command is not None:
            before_s = start_s
            for time_s in _times(start_s, end_s):
                self._body.advance(time_s - before_s, self._command)
                body = self._body
                self.path.update(time_s, body.pose, body.velocity_mps, body.turn_rates_rps)
                before_s = time_s
        else:
            here = self.path.pose(start_s)
            goal, self._goal = self._goal or here, None
            moved_m = goal.rotation.T @ (goal.position_m - here.position_m)
            turned = rotation_vector(here.rotation.T @ goal.rotation)
            self.path.jump(start_s, here)
            step_s = end_s - start_s
            self.path.update(end_s, goal, moved_m / step_s, turned / step_s)


class World:
    """A scene with vehicles, whose clock goes on by `step` alone.

    Equal seeds and steps give equal bytes.

    Args:
        scene: what is there besides the vehicles.
        seed: of speckle and noise; each sonar draws its own.
        effects: as for `Simulator`.
        threads: of each ping, at most.

    Raises:
        EffectError: an effect is unknown.

    Attributes:
        time_s: on its clock, from 0; moving objects of the scene go by it.
        vehicles: by name.
    """

    def __init__(
        self, scene: Scene, *, seed: int = 0, effects: Choice = AUTO, threads: int = 2
    ) -> None:
        EffectSelection.read(effects)  # report unknown names now
        self.scene = scene
        self.time_s = 0.0
        self.vehicles: dict[str, WorldVehicle] = {}
        self._seed = seed
        self._effects = effects
        self._threads = threads
        self._simulators: dict[tuple[str, str], Simulator] = {}

    @classmethod
    def of(cls, scenario: Scenario, *, seed: int = 0, effects: Choice = AUTO) -> Self:
        """Make the world of a scenario: its vehicles on their paths, where they stay at the end."""
        world = cls(scenario.scene, seed=seed, effects=effects)
        for one in (scenario, *scenario.others):
            vehicle = world.vehicles.get(one.vehicle.name)
            if vehicle is None:
                vehicle = world.add_vehicle(one.vehicle, one.trajectory.pose(0.0))
                vehicle.follow(Route(one.trajectory, "stay"))
            vehicle.add_sonar(one.sonar_name, one.sonar, one.mounting, one.ping_rate_hz)
        return world

    def add_vehicle(self, vehicle: Vehicle | str, pose: FramePose) -> WorldVehicle:
        """Put a vehicle into the world.

        Args:
            vehicle: its name and size; a name alone has no size, and no other sonar sees it.
            pose: of its base in the map.

        Raises:
            SonarSimError: the name is taken, or the pose is not finite.
        """
        require_finite(pose)
        kind = Vehicle(vehicle) if isinstance(vehicle, str) else vehicle
        if kind.name in self.vehicles:
            raise SonarSimError(f"the world already has a vehicle {kind.name!r}")
        made = WorldVehicle(self, kind, pose)
        self.vehicles[kind.name] = made
        self._simulators.clear()  # others see it
        return made

    def step(self, dt_s: float) -> list[WorldPing]:
        """Let time go on.

        Args:
            dt_s: by so much.

        Returns:
            The pings that became due, in the order of their times: later than the time before the
            step, not later than that after it.

        Raises:
            SonarSimError: the step is not more than 0, or longer than 5 s.
        """
        if not 0.0 < dt_s <= MAX_STEP_S:
            raise SonarSimError(f"a step of {dt_s} s; steps are more than 0, at most 5 s")
        start_s, end_s = self.time_s, self.time_s + dt_s
        for vehicle in self.vehicles.values():
            vehicle.advance(start_s, end_s)
        self.time_s = end_s
        sonars = [one for vehicle in self.vehicles.values() for one in vehicle.sonars.values()]
        pings: list[WorldPing] = []
        while sonars:
            first = min(sonars, key=_due_s)
            if first.due_s > end_s + EARLY_S:
                break
            pings.append(first.due_ping())
        return pings

    def simulator(self, vehicle: WorldVehicle, sonar: WorldSonar) -> Simulator:
        """Return a sonar's simulator, in which it sees all vehicles but its own."""
        key = vehicle.name, sonar.name
        if key not in self._simulators:
            paths = {name: (one.vehicle, one.path) for name, one in self.vehicles.items()}
            del paths[vehicle.name]
            number = zlib.crc32("\0".join(key).encode())
            seed = int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])
            self._simulators[key] = Simulator(
                with_bodies(self.scene, paths.values()),
                sonar.settings,
                seed,
                effects=self._effects,
                threads=self._threads,
            )
        return self._simulators[key]


def _due_s(sonar: WorldSonar) -> float:
    return sonar.due_s


def _times(start_s: float, end_s: float) -> NDArray[np.float64]:
    """Times after the start to the end, close enough for a path, (N,)."""
    return np.linspace(start_s, end_s, max(1, math.ceil((end_s - start_s) / 0.02)) + 1)[1:]
