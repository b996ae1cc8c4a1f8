"""A survey as a capture: the bytes that the links of a vehicle would deliver."""

import heapq
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter
from sonar_sim.effects.plan import AUTO, Choice
from sonar_sim.errors import SceneError
from sonar_sim.geometry.trajectory import Route
from sonar_sim.raycast.visible_surface import VisibleSurface
from sonar_sim.scene.scenario import Scenario, sonar_motion, sonar_pose, with_bodies
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.vehicle import (
    OdometrySample,
    SimulatedOdometry,
    in_order_of_arrival,
    odometry_record,
)
from sonar_sim.simulator import PingRequest, SimulatorSpec, simulate_pings
from sonar_sim.wire import Network, compass_heading_deg, delivered, ping_message

EPOCH_NS = 1_767_225_600_000_000_000
"""2026-01-01T00:00:00Z: captures start at a fixed time, so that equal seeds give equal files."""
POWER_UP_S = 100.0
"""Time from power-up of the sonar to the beginning of the path."""
NETWORK_STREAM = 2
"""Keeps these random numbers apart from the simulator's own."""

Progress = Callable[[int, int], None]
"""Called with the pings done and the pings in all."""
Delivery = tuple[float, str, bytes]
Samples = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """How a survey is recorded.

    Attributes:
        seed: of all random numbers.
        lead_s: odometry before the first ping and after the last.
        quiet_s: of the path's beginning, with odometry alone: the sonar is not sounding yet.
        processes: that simulate; changes nothing in the file.
        network: the way from the sonar to the host.
        effects: what the simulator computes.
    """

    seed: int = 7
    lead_s: float = 0.5
    quiet_s: float = 0.0
    processes: int = os.cpu_count() or 1
    network: Network = field(default_factory=Network)
    effects: Choice = AUTO


def ping_times_s(scenario: Scenario, settings: CaptureSettings) -> list[float]:
    """When the sonar transmits, in seconds on the path."""
    first_s = settings.quiet_s + settings.lead_s
    span_s = scenario.trajectory.duration_s - settings.lead_s - first_s
    rate_hz = scenario.true_ping_rate_hz
    pings = int(max(span_s, 0.0) * rate_hz) + 1
    return [first_s + k / rate_hz for k in range(pings)]


def write_capture(
    path: Path,
    scenario: Scenario,
    settings: CaptureSettings | None = None,
    progress: Progress | None = None,
    navigation: Iterable[OdometrySample] | None = None,
) -> VisibleSurface:
    """Simulate a survey and record it.

    Args:
        path: the recording; links `sonar` (the TCP stream) and `odometry` (native records).
        scenario: what to simulate.
        settings: seed and network.
        progress: called after each ping.
        navigation: odometry samples to record; None records those of the scenario's vehicle.

    Returns:
        The surface that the sonar had in sight.

    Raises:
        SceneError: the sonar does not speak the Oculus protocol.
    """
    if not scenario.sonar.on_wire:
        raise SceneError(
            f"{scenario.name}: a {scenario.sonar.model} does not speak the Oculus protocol and "
            "cannot be recorded; render it, or choose an Oculus"
        )
    settings = settings or CaptureSettings()
    seen = VisibleSurface()
    pings = _sonar_link(scenario, settings, seen, progress)
    if navigation is None:
        navigation = SimulatedOdometry(
            scenario.trajectory, scenario.vehicle, settings.seed
        ).samples()
    odometry = _odometry_link(navigation)
    with RecordingWriter(path, overwrite=True) as recording:
        links = {
            "sonar": recording.add_link("sonar", OCULUS),
            "odometry": recording.add_link("odometry", ODOMETRY_NATIVE),
        }
        for time_s, name, data in heapq.merge(pings, odometry, key=lambda arrival: arrival[0]):
            recording.write(links[name], data, _unix_ns(time_s))
    return seen


def _sonar_link(
    scenario: Scenario, settings: CaptureSettings, seen: VisibleSurface, progress: Progress | None
) -> Iterator[Delivery]:
    """The sonar's TCP stream, read by read."""
    sonar, water = scenario.sonar, scenario.scene.water
    times_s = ping_times_s(scenario, settings)
    shots = [PingRequest(sonar_pose(scenario, t), t, sonar_motion(scenario, t)) for t in times_s]
    generator = _generator(settings.seed, NETWORK_STREAM)
    listening_s = 2.0 * sonar.range_m / (sonar.told_speed_mps or water.speed_of_sound_mps)
    recipe = SimulatorSpec(_scene_of(scenario), sonar, settings.seed, settings.effects)
    pings = simulate_pings(recipe, shots, settings.processes)
    for ping_id, (time_s, ping) in enumerate(zip(times_s, pings, strict=True)):
        seen.add(ping.seen_m)
        message = ping_message(
            cast("Samples", ping.image),  # no effect is switched off, quantisation neither
            ping_id=ping_id,
            start_time_s=POWER_UP_S + time_s,
            heading_deg=compass_heading_deg(scenario.trajectory.pose(time_s).rotation),
            sonar=sonar,
            water=water,
        )
        ready_s = time_s + listening_s
        for arrival_s, piece in delivered(message, ready_s, settings.network, generator):
            yield arrival_s, "sonar", piece
        if progress is not None:
            progress(ping_id + 1, len(times_s))


def _scene_of(scenario: Scenario) -> Scene:
    """The scene with the other vehicles on their paths, at whose ends they stay."""
    paths = {one.vehicle: Route(one.trajectory, "stay") for one in scenario.others}
    paths.pop(scenario.vehicle, None)
    return with_bodies(scenario.scene, paths.items())


def _odometry_link(samples: Iterable[OdometrySample]) -> Iterator[Delivery]:
    """Native records, one a datagram."""
    for sample in in_order_of_arrival(samples):
        yield sample.arrival_s, "odometry", odometry_record(sample, _unix_ns(sample.time_s))


def _generator(seed: int, stream: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, stream])))


def _unix_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
