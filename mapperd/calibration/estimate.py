"""The estimate: floor first, then structure; what is observable; the lines of the settings file."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mapperd.calibration.agreement import PARAMETERS, Agreement, Blur, View
from mapperd.calibration.dive import Dive
from mapperd.calibration.floor import FloorEchoes, fit_floor, floor_echoes
from mapperd.config.tree import Config
from mapperd.geometry.frames import quaternion_to_matrix, rotation_from_rpy

__all__ = ["Calibration", "Parameter", "calibrate", "start_of", "yaml_lines"]

Floats = NDArray[np.float64]

BLURS = (0.02, 0.008, 0.004, 0.004, 0.004)
"""Blur of each round, as a share of the range."""

SINE_PER_RANGE = 2.0
ECHOES = 1200
ROUNDS = 6
FLOOR = np.array([0, 2, 6, 7])
STRUCTURE = np.array([0, 1, 2, 6])
SEED = 5
LIMITS = {"roll": 0.5, "yaw": 0.5, "time_offset": 0.02, "range_scale": 0.005}
"""A parameter whose standard deviation is larger is not observable."""

PLAUSIBLE = {"roll": 15.0, "yaw": 15.0, "time_offset": 0.25, "range_scale": 0.06}
"""A larger change shows that the fit went astray."""

REASONS = {
    "pitch": "a turn about the array changes no range and no bearing",
    "x": "the map moves with it",
    "y": "the map moves with it",
    "z": "the map moves with it",
}
DEFAULT_REASON = "the dive does not show it: more turns, heights and overlap are needed"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of the calibration.

    Attributes:
        name: of `PARAMETERS`.
        change: against the settings; 0 if it is left.
        deviation: standard deviation.
        reason: why the recording does not show it; empty if it does.
    """

    name: str
    change: float
    deviation: float
    reason: str = ""

    @property
    def observable(self) -> bool:
        """Whether the recording shows it."""
        return not self.reason


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        parameters: all, in the order of `PARAMETERS`.
        start, values: (8,) parameters at the start and at the end.
        view: of the sonar at the start.
        floor: echoes of the floor.
    """

    parameters: tuple[Parameter, ...]
    start: Floats
    values: Floats
    view: View
    floor: FloorEchoes


def start_of(config: Config) -> tuple[View, Floats]:
    """Return the sonar and the parameters of the settings."""
    angles, position = config.mounting.orientation, config.mounting.position
    view = View(
        quaternion_to_matrix(rotation_from_rpy(angles.roll, angles.pitch, angles.yaw)),
        math.radians(config.sonar.vertical_aperture),
        config.filtering.min_range,
    )
    return view, np.array([0, 0, 0, position.x, position.y, position.z, 0, 1], dtype=np.float64)


def calibrate(
    dive: Dive, config: Config, progress: Callable[[str], None] = lambda _: None
) -> Calibration:
    """Estimate mounting, time offset and scale of the ranges.

    The floor gives the scale, for its echoes have no unknown elevation; structure gives the rest.

    Args:
        dive: of a recording.
        config: the settings to start from.
        progress: called with what is done next.
    """
    view, start = start_of(config)
    progress("floor")
    echoes = floor_echoes(dive, view)
    values, deviation = fit_floor(dive, view, echoes, start, FLOOR)
    deviations = np.full(len(PARAMETERS), np.inf)
    deviations[FLOOR] = deviation
    if not deviations[7] <= LIMITS["range_scale"] or _astray(values - start):
        values = start.copy()
        deviations[FLOOR] = np.inf
    found = start.copy()
    found[[0, 7]] = values[[0, 7]]
    for number, share in enumerate(BLURS):
        progress(f"structure, round {number + 1} of {len(BLURS)}")
        blur = Blur(share * dive.range_m, share * SINE_PER_RANGE)
        agreement = Agreement(dive, view, blur, found, echoes=ECHOES, seed=SEED + number)
        found, deviation = agreement.improve(found, STRUCTURE, ROUNDS)
        deviations[STRUCTURE] = deviation
        if astray := _astray(found - start):
            found, deviations = start.copy(), np.full(len(PARAMETERS), np.inf)
            progress(f"the fit of {', '.join(astray)} went astray: nothing is changed")
            break
    parameters = tuple(
        _parameter(name, found[k] - start[k], deviations[k]) for k, name in enumerate(PARAMETERS)
    )
    used = np.array([one.change for one in parameters]) + start
    return Calibration(parameters, start, used, view, echoes)


def _astray(change: Floats) -> list[str]:
    """Return the parameters whose change cannot be true."""
    sizes = dict(zip(PARAMETERS, np.abs(change), strict=True))
    return [name for name, largest in PLAUSIBLE.items() if not sizes[name] <= largest]


def _parameter(name: str, change: float, deviation: float) -> Parameter:
    limit = LIMITS.get(name)
    if limit is None or not deviation <= limit:
        return Parameter(name, 0.0, deviation, REASONS.get(name, DEFAULT_REASON))
    return Parameter(name, float(change), float(deviation))


def yaml_lines(found: Calibration, config: Config, sound_mps: float) -> str:
    """Return the lines of the settings file that put a calibration into force.

    Args:
        found: the calibration.
        config: the settings it started from.
        sound_mps: speed of sound of the recording.
    """
    angles = Rotation.from_matrix(found.view.mounting(found.values)).as_euler("ZYX", degrees=True)
    yaw, pitch, roll = (round(float(angle), 2) + 0.0 for angle in angles)
    lines = [
        "mounting:",
        f"  orientation: {{ roll: {roll}, pitch: {pitch}, yaw: {yaw} }}",
    ]
    by_name = {one.name: one for one in found.parameters}
    if by_name["range_scale"].observable:
        speed = sound_mps * found.values[7]
        lines += ["water:", f"  speed_of_sound: {speed:.1f}", "  correct_ranges: true"]
    offset_s = by_name["time_offset"].change
    if by_name["time_offset"].observable:
        latency_s = config.device.latency_sec - offset_s
        if latency_s >= 0:
            lines += ["device:", f"  latency_sec: {latency_s:.3f}"]
        else:
            lines += [f"# odometry.sources[].latency_sec: add {-latency_s:.3f}"]
    return "\n".join(lines) + "\n"
