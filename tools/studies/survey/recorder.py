"""One dive as a recording, by one process.

The echoes are those of the simulator's own rules, with fewer rays and scatterers than it takes by
default. That takes two thirds of the time; over the full survey's floor the mean power of no
stretch of ranges changes by more than 0.3 dB, nor the share of samples above the threshold by more
than 4 %.
"""

import heapq
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from sonar_sim import load_scenario
from sonar_sim.capture import EPOCH_NS, POWER_UP_S, CaptureSettings, ping_times_s
from sonar_sim.odometry import odometry_record
from sonar_sim.scenario import Scenario
from sonar_sim.simulator import Simulator
from sonar_sim.sonar_motion import sonar_motion, sonar_pose
from sonar_sim.vehicle import Odometry, in_order_of_arrival
from sonar_sim.wire import Network, compass_heading_deg, delivered, ping_message

from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, RecordingWriter
from studies.survey.dives import Dive

ELEVATIONS = 64
NODES_PER_BEAM = 2.0

Progress = Callable[[int, int], None]
"""Called with the pings done and the pings in all."""
Arrival = tuple[float, str, bytes]


def record(dive: Dive, folder: Path, progress: Progress | None = None) -> Path:
    """Write `NAME.yaml`, the scene, and `NAME.mcap`; a recording that is there is kept.

    The recording is there whole or not at all. Equal dives give equal bytes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, scene = folder / f"{dive.name}.mcap", folder / f"{dive.name}.yaml"
    text = json.dumps(dive.scene, indent=1)  # YAML too, and without the aliases of a dumper
    if path.exists() and scene.exists() and scene.read_text(encoding="utf-8") == text:
        return path
    path.unlink(missing_ok=True)
    scene.write_text(text, encoding="utf-8")
    unfinished = path.with_suffix(".part")
    _write(unfinished, dive, load_scenario(scene), progress)
    unfinished.replace(path)
    return path


def _write(path: Path, dive: Dive, scenario: Scenario, progress: Progress | None) -> None:
    start_ns = EPOCH_NS + round(dive.start_s * 1e9)
    pings = _sonar_link(dive, scenario, progress)
    odometry = _odometry_link(dive, scenario, start_ns)
    with RecordingWriter(path, overwrite=True) as recording:
        links = {
            "sonar": recording.add_link("sonar", OCULUS),
            "odometry": recording.add_link("odometry", ODOMETRY_NATIVE),
        }
        for time_s, name, data in heapq.merge(pings, odometry, key=lambda arrival: arrival[0]):
            recording.write(links[name], data, start_ns + round(time_s * 1e9))


def _sonar_link(dive: Dive, scenario: Scenario, progress: Progress | None) -> Iterator[Arrival]:
    sonar, water = scenario.sonar, scenario.scene.water
    simulator = Simulator(
        scenario.scene,
        sonar,
        dive.seed,
        threads=1,
        elevations=ELEVATIONS,
        nodes_per_beam=NODES_PER_BEAM,
    )
    generator = np.random.default_rng([dive.seed, 2])
    times_s = ping_times_s(scenario, CaptureSettings())
    listening_s = 2.0 * sonar.range_m / water.speed_of_sound_mps
    for number, time_s in enumerate(times_s):
        ping = simulator.ping(
            sonar_pose(scenario, time_s), number, time_s, sonar_motion(scenario, time_s)
        )
        message = ping_message(
            ping.image.astype(np.uint8, copy=False),
            ping_id=number,
            start_time_s=POWER_UP_S + time_s,
            heading_deg=compass_heading_deg(scenario.trajectory.pose(time_s).rotation),
            sonar=sonar,
            water=water,
        )
        for arrival_s, piece in delivered(message, time_s + listening_s, Network(), generator):
            yield arrival_s, "sonar", piece
        if progress is not None:
            progress(number + 1, len(times_s))


def _odometry_link(dive: Dive, scenario: Scenario, start_ns: int) -> Iterator[Arrival]:
    odometry = Odometry(scenario.trajectory, scenario.vehicle, dive.seed)
    for sample in in_order_of_arrival(odometry.samples()):
        record = odometry_record(sample, start_ns + round(sample.time_s * 1e9))
        yield sample.arrival_s, "odometry", record
