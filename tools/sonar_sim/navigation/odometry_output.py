"""Send the vehicle's odometry to its links, altimeter included."""

import asyncio
import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from sonar_sim.capture import POWER_UP_S
from sonar_sim.geometry.pose import FramePose
from sonar_sim.geometry.trajectory import Trajectory
from sonar_sim.navigation.fix import Fix
from sonar_sim.navigation.formats import Format, format_named
from sonar_sim.navigation.links import OdometryOutlet, link_named
from sonar_sim.scene.scenario import Scenario
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.vehicle import OdometrySample, SimulatedOdometry

__all__ = ["OdometryOutput", "OdometrySender", "output_named"]


class Altimeter:
    """One ray along the vehicle's own downward axis; moving objects are taken where they begin."""

    def __init__(self, scene: Scene) -> None:
        triangles = scene.triangles_m.astype(np.float32)
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, triangles) if len(triangles) else None

    def altitude_m(self, map_T_base: FramePose) -> float | None:  # noqa: N803 frames are named
        """Distance to the first surface below; None where nothing is."""
        if self._mesh is None:
            return None
        found = self._scene.run(
            map_T_base.position_m[None].astype(np.float32),
            -map_T_base.rotation[:, 2][None].astype(np.float32),
            output=True,
        )
        return float(found["tfar"][0]) if found["primID"][0] >= 0 else None


@dataclass(slots=True)
class OdometryOutput:
    """A format on a link.

    Attributes:
        name: `FORMAT@LINK`.
        form, link: of it.
        sent: datagrams, lines or sentences.
    """

    name: str
    form: Format
    link: OdometryOutlet
    sent: int = 0


def output_named(text: str) -> OdometryOutput:
    """An output from `FORMAT@LINK`, such as `native@udp:127.0.0.1:52200`.

    Raises:
        SonarSimError: format or link is unknown.
    """
    form, _, link = text.partition("@")
    return OdometryOutput(text, format_named(form), link_named(link))


class OdometrySender:
    """Sends the vehicle's odometry with all its errors; records come as late as they would.

    Args:
        scenario: scene and vehicle.
        route: of the vehicle.
        outputs: where to send.
        unix_ns: Unix time of a time on the route.
        seed: of the errors.
    """

    def __init__(
        self,
        scenario: Scenario,
        route: Trajectory,
        outputs: list[OdometryOutput],
        unix_ns: Callable[[float], int],
        seed: int = 0,
    ) -> None:
        self.outputs = outputs
        self._scenario = scenario
        self._route = route
        self._unix_ns = unix_ns
        self._odometry = SimulatedOdometry(route, scenario.vehicle, seed)
        self._altimeter = Altimeter(scenario.scene)

    async def open(self) -> None:
        """Open all links.

        Raises:
            SonarSimError: one cannot be opened.
        """
        for output in self.outputs:
            await output.link.open()

    async def run(self, clock: Callable[[], float]) -> None:
        """Send until the route ends.

        Args:
            clock: seconds on the route.
        """
        latency_s = self._scenario.vehicle.errors.latency_s
        for sample in by_arrival(self._odometry.samples(), latency_s):
            await asyncio.sleep(sample.arrival_s - clock())
            self._send(self.fix(sample))

    async def close(self) -> None:
        """Close all links."""
        for output in self.outputs:
            await output.link.close()

    def fix(self, sample: OdometrySample) -> Fix:
        """A sample with everything that the formats encode."""
        return Fix(
            sample=sample,
            valid_ns=self._unix_ns(sample.time_s),
            sent_ns=self._unix_ns(sample.arrival_s),
            boot_s=POWER_UP_S + sample.time_s,
            altitude_m=self._altimeter.altitude_m(self._route.pose(sample.time_s)),
            vehicle=self._scenario.vehicle,
            water=self._scenario.scene.water,
        )

    def _send(self, fix: Fix) -> None:
        for output in self.outputs:
            for data in output.form.encode(fix):
                output.link.send(data)
                output.sent += 1


def by_arrival(samples: Iterator[OdometrySample], latency_s: float) -> Iterator[OdometrySample]:
    """Samples as they reach the host; those that jitter overtook come later.

    Args:
        samples: in the order of their validity; perhaps without end.
        latency_s: that each of them takes at least.
    """
    waiting: list[tuple[float, int, OdometrySample]] = []
    for number, sample in enumerate(samples):
        while waiting and waiting[0][0] <= sample.time_s + latency_s:
            yield heapq.heappop(waiting)[2]
        heapq.heappush(waiting, (sample.arrival_s, number, sample))
    while waiting:
        yield heapq.heappop(waiting)[2]
