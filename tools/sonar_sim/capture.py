"""A survey as a capture: what the links of a vehicle would have brought, byte for byte."""

import heapq
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter
from sonar_sim.odometry import OdometryNoise, odometry_record
from sonar_sim.pool import SimulatorRecipe, simulate_pings
from sonar_sim.poses import Mounting
from sonar_sim.scene import Scene
from sonar_sim.seen import SeenSurface
from sonar_sim.sonar import SonarSettings
from sonar_sim.trajectory import Trajectory
from sonar_sim.water import Water
from sonar_sim.wire import Network, compass_heading_deg, delivered, ping_message

EPOCH_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: captures start at a fixed time, so that equal seeds give equal files."""
POWER_UP_S = 100.0
"""The sonar has been on for so long when the path begins."""
NETWORK_STREAM, ODOMETRY_STREAM = 2, 3
"""Keep these random numbers apart from the simulator's own."""

Progress = Callable[[int, int], None]
"""Called with the pings done and the pings in all."""
Arrival = tuple[float, str, bytes]


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """How a survey is recorded.

    Attributes:
        seed: of all random numbers.
        ping_rate_hz, odometry_rate_hz: of the two links.
        lead_s: odometry before the first ping and after the last.
        odometry_latency_s: from validity to arrival.
        processes: that simulate; changes nothing in the file.
    """

    seed: int = 7
    ping_rate_hz: float = 5.0
    odometry_rate_hz: float = 25.0
    lead_s: float = 0.5
    odometry_latency_s: float = 0.002
    processes: int = os.cpu_count() or 1
    mounting: Mounting = field(default_factory=Mounting)
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    network: Network = field(default_factory=Network)


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What is simulated: a sonar on a vehicle that drives through a scene."""

    scene: Scene
    sonar: SonarSettings
    trajectory: Trajectory
    water: Water = field(default_factory=Water)


def ping_times_s(trajectory: Trajectory, settings: CaptureSettings) -> list[float]:
    """When the sonar transmits, in seconds on the path."""
    span_s = trajectory.duration_s - 2.0 * settings.lead_s
    pings = int(span_s * settings.ping_rate_hz) + 1
    return [settings.lead_s + k / settings.ping_rate_hz for k in range(pings)]


def write_capture(
    path: Path,
    survey: Survey,
    settings: CaptureSettings | None = None,
    progress: Progress | None = None,
) -> SeenSurface:
    """Simulate a survey and record it.

    Args:
        path: the recording; links `sonar` (the TCP stream) and `odometry` (native records).
        survey: what to simulate.
        settings: rates, seed and network.
        progress: is told after each ping.

    Returns:
        The surface that the sonar had in sight.
    """
    settings = settings or CaptureSettings()
    seen = SeenSurface()
    pings = _sonar_link(survey, settings, seen, progress)
    odometry = _odometry_link(survey.trajectory, settings)
    with RecordingWriter(path, overwrite=True) as recording:
        links = {
            "sonar": recording.add_link("sonar", OCULUS),
            "odometry": recording.add_link("odometry", ODOMETRY_NATIVE),
        }
        for time_s, name, data in heapq.merge(pings, odometry, key=lambda arrival: arrival[0]):
            recording.write(links[name], data, _unix_ns(time_s))
    return seen


def _sonar_link(
    survey: Survey, settings: CaptureSettings, seen: SeenSurface, progress: Progress | None
) -> Iterator[Arrival]:
    """The sonar's TCP stream, read by read."""
    sonar, water = survey.sonar, survey.water
    times_s = ping_times_s(survey.trajectory, settings)
    bases = [survey.trajectory.pose(time_s) for time_s in times_s]
    poses = [base @ settings.mounting.pose for base in bases]
    generator = _generator(settings.seed, NETWORK_STREAM)
    listening_s = 2.0 * sonar.range_m / water.speed_of_sound_mps
    recipe = SimulatorRecipe(survey.scene, sonar, water, settings.seed)
    pings = simulate_pings(recipe, poses, settings.processes)
    for ping_id, (time_s, base, ping) in enumerate(zip(times_s, bases, pings, strict=True)):
        seen.add(ping.seen_m)
        message = ping_message(
            ping.image,
            ping_id=ping_id,
            start_time_s=POWER_UP_S + time_s,
            heading_deg=compass_heading_deg(base.rotation),
            sonar=sonar,
            water=water,
        )
        ready_s = time_s + listening_s
        for arrival_s, piece in delivered(message, ready_s, settings.network, generator):
            yield arrival_s, "sonar", piece
        if progress is not None:
            progress(ping_id + 1, len(times_s))


def _odometry_link(trajectory: Trajectory, settings: CaptureSettings) -> Iterator[Arrival]:
    """Native records, one a datagram."""
    generator = _generator(settings.seed, ODOMETRY_STREAM)
    records = int(trajectory.duration_s * settings.odometry_rate_hz) + 1
    for k in range(records):
        time_s = k / settings.odometry_rate_hz
        record = odometry_record(
            trajectory, time_s, _unix_ns(time_s), settings.odometry_noise, generator
        )
        yield time_s + settings.odometry_latency_s, "odometry", record


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, stream])))


def _unix_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
