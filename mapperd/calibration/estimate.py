"""The estimate: floor first, then structure; what is observable; the lines of the settings file.

The floor gives roll, scale of the ranges and time offset. The first echo of a beam comes from where
the floor is nearest, which on a smooth floor lies in the upright plane through the array. So its
elevation is known, and passes at several heights, roll angles and headings that overlap must find
the same heights.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from mapperd.calibration.agreement import PARAMETERS, STEPS, Agreement, Blur, SonarView
from mapperd.calibration.dive import CalibrationDive
from mapperd.config.tree import Config, OrientationConfig
from mapperd.geometry.frames import quaternion_to_matrix, rotation_from_rpy

__all__ = [
    "Calibration",
    "FloorEchoes",
    "ParameterEstimate",
    "calibrate",
    "fit_floor",
    "floor_echoes",
    "floor_points",
    "nearest_angles",
    "start_of",
    "yaml_lines",
]

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]


MAX_SINE = 0.5
"""Beams further to the side are left out: their first echo comes from the near edge of the beam."""

EVERY_BEAM = 4
FIRST_SHARE = 0.5
"""The first echo is the first peak above this share of the beam's brightest sample."""

CLIMB_ROWS = 12
MIN_BRIGHTNESS = 3.0
CELL_M = 0.4
GATES_M = (0.4, 0.24, 0.15, 0.09, 0.08, 0.08, 0.08, 0.08)
"""Largest distance from the median height of a cell, by round: what stands on the floor goes."""

NOISE_M = 0.03
CORRELATED = 25.0
"""Number of neighbouring echoes that err alike: of one ping, and of one stone."""


@dataclass(frozen=True, slots=True, eq=False)
class FloorEchoes:
    """First echoes.

    Attributes:
        ping: (N,) index of the ping.
        sine: (N,) sine of the bearing.
        range_m: (N,) as measured.
    """

    ping: Numbers
    sine: Floats
    range_m: Floats


def floor_echoes(dive: CalibrationDive, view: SonarView) -> FloorEchoes:
    """Find the first echo of every fourth beam of each ping."""
    images = gaussian_filter(np.sqrt(np.clip(dive.images - 4.0, 0.0, None)), (0, 1, 1))
    rows = images.shape[1]
    columns = np.arange(0, images.shape[2], EVERY_BEAM)
    sines = dive.first_sine + columns * dive.sine_step
    inside = np.abs(sines) < MAX_SINE
    columns, sines = columns[inside], sines[inside]
    profile = images[:, :, columns].copy()
    profile[:, : int(view.min_range_m / dive.row_m)] = 0

    def at(row: Numbers) -> Floats:
        found = np.take_along_axis(profile, np.clip(row, 0, rows - 1)[:, None, :], axis=1)
        return np.asarray(found[:, 0], dtype=np.float64)

    brightest = profile.max(axis=1)
    peak = (profile >= FIRST_SHARE * brightest[:, None, :]).argmax(axis=1)
    for _ in range(CLIMB_ROWS):
        peak = np.where(at(peak + 1) > at(peak), peak + 1, peak)
    before, top, after = at(peak - 1), at(peak), at(peak + 1)
    bend = before - 2 * top + after
    bent = np.abs(bend) > 1e-6  # noqa: PLR2004 flat
    shift = np.where(bent, 0.5 * (before - after) / np.where(bent, bend, 1.0), 0.0)
    ping, place = np.nonzero((brightest > MIN_BRIGHTNESS) & (peak < rows - 2))
    range_m = (peak + np.clip(shift, -0.5, 0.5) + 0.5) * dive.row_m
    return FloorEchoes(ping, sines[place], range_m[ping, place])


def floor_points(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the echoes in the map, (N, 3) m, and which of them lie inside the vertical beam."""
    motion = dive.motion(float(values[6]))
    mounting = view.mounting(values)
    ping = echoes.ping
    down = np.einsum("nji,j->ni", motion.rotation @ mounting, np.array([0.0, 0.0, -1.0]))[ping]
    elevation = np.arctan2(down[:, 2], down[:, 0])
    across = np.sqrt(1.0 - echoes.sine**2)
    ray = np.stack([across * np.cos(elevation), -echoes.sine, across * np.sin(elevation)], axis=1)
    range_m = values[7] * echoes.range_m
    sonar = ray * range_m[:, None]
    sonar = sonar + dive.drift(motion, mounting, values[3:6], ping, sonar)
    base = sonar @ mounting.T + values[3:6]
    points = np.einsum("nij,nj->ni", motion.rotation[ping], base) + motion.position_m[ping]
    return points, np.abs(elevation) < view.aperture_rad


def fit_floor(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats, free: Numbers
) -> tuple[Floats, Floats]:
    """Fit parameters so that the heights in each cell agree.

    Args:
        dive: pings and path.
        view: of the sonar.
        echoes: of the floor.
        values: (8,) parameters at the start.
        free: indices of those to fit.

    Returns:
        The parameters, (8,), and the standard deviations of the free ones; infinite ones without
        enough floor.
    """
    spread = np.full(len(free), np.inf)
    steps = STEPS[free]
    for gate_m in GATES_M:
        points, lit = floor_points(dive, view, echoes, values)
        cell, median_m = _cells(points)
        used = lit & (np.abs(points[:, 2] - median_m) < gate_m)
        if used.sum() < 10 * len(free):
            return values, np.full(len(free), np.inf)
        chosen = FloorEchoes(echoes.ping[used], echoes.sine[used], echoes.range_m[used])
        for _ in range(2):
            residuals = _residuals(dive, view, chosen, values, cell[used])
            slopes = []
            for place, step in zip(free, steps, strict=True):
                moved = np.zeros(len(values))
                moved[place] = 0.2 * step
                up, low = (
                    _residuals(dive, view, chosen, values + sign * moved, cell[used])
                    for sign in (1, -1)
                )
                slopes.append((up - low) / 0.4)
            jacobian = np.stack(slopes, axis=1)
            weight = 1.0 / (1.0 + (residuals / NOISE_M) ** 2)
            normal = jacobian.T @ (jacobian * weight[:, None])
            normal += 1e-9 * np.trace(normal) * np.eye(len(free))
            values = values.copy()
            values[free] -= np.linalg.solve(normal, jacobian.T @ (weight * residuals)) * steps
            noise_m = math.sqrt(CORRELATED * float(np.average(residuals**2, weights=weight)))
            spread = noise_m * np.sqrt(np.diag(np.linalg.inv(normal))) * steps
    return values, spread


def _cells(points: Floats) -> tuple[Numbers, Floats]:
    """Return the cell of each point and the median height in it."""
    place = np.floor(points[:, :2] / CELL_M).astype(np.intp)
    place -= place.min(axis=0)
    _, cell = np.unique(place[:, 0] * (place[:, 1].max() + 1) + place[:, 1], return_inverse=True)
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order])) + 1
    medians = np.array([np.median(part) for part in np.split(points[order, 2], starts)])
    return cell, medians[cell]


def _residuals(
    dive: CalibrationDive, view: SonarView, echoes: FloorEchoes, values: Floats, cell: Numbers
) -> Floats:
    height_m = floor_points(dive, view, echoes, values)[0][:, 2]
    count = np.maximum(np.bincount(cell), 1)
    return np.asarray(height_m - (np.bincount(cell, height_m) / count)[cell])


@dataclass(frozen=True, slots=True)
class Stage:
    """Rounds with equal blur; each chooses other echoes.

    Attributes:
        blur: as a share of the range.
        side_deg: largest angle between two views of a point.
        rounds: at most.
    """

    blur: float
    side_deg: float
    rounds: int


STAGES = (Stage(0.02, 30.0, 2), Stage(0.008, 30.0, 4), Stage(0.004, 30.0, 5))

LAST_WITH_FLOOR = (Stage(0.008, 60.0, 4), Stage(0.004, 60.0, 6))
"""Give the result where the floor gives the scale: the wider blur lets the fit move."""

LAST_WITHOUT_FLOOR = (Stage(0.004, 18.0, 6),)
"""The same where structure gives the scale too: views from one side alone do not shift it."""

AVERAGED = 3
"""Number of last rounds whose mean is the result."""

SETTLED = 0.7
"""A stage ends when no parameter changes by more than this share of its deviation."""

SIDE_SHARE = 0.5
"""Share of the difference between the last two stages that counts as an error of the result."""

PICTURE_SIDE_DEG = 60.0
SINE_PER_RANGE = 2.0
ECHOES = 6000
"""Drawn at random for a fit. With half as many, the draw moved the yaw by 0.1 deg."""

STEPS_OF_ROUND = 10
FLOOR = np.array([0, 2, 6, 7])
STRUCTURE = np.array([0, 2, 6])
STRUCTURE_AND_SCALE = np.array([0, 2, 6, 7])
SEED = 5
VERTICAL = 3e-4
"""An x axis whose horizontal part is smaller is vertical: its rounded angles are the same."""

LIMITS = {"roll": 0.3, "yaw": 0.3, "time_offset": 0.010, "range_scale": 0.003}
"""A parameter whose standard deviation is larger is not observable."""

MIN_DEVIATION = {"roll": 0.03, "yaw": 0.2, "time_offset": 0.003, "range_scale": 0.001}
"""Errors of the model: another side of a thing is another surface, which turns the yaw."""

WITHOUT_FLOOR = {"roll": 0.4, "range_scale": 0.004}
"""The same where structure alone gives these: of a wall or a pile the sonar shows
what its beam cuts out, which moves with the vehicle, as a wrong scale does."""

FLOOR_SCALE_LIMIT = 0.005
"""The floor is used if the standard deviation of its scale is smaller."""

PLAUSIBLE = {"roll": 15.0, "yaw": 15.0, "time_offset": 0.25, "range_scale": 0.06}
"""A larger change shows that the fit went astray."""

REASONS = {
    "pitch": "a turn about the array changes no range and no bearing",
    "x": "a ruler is better",
    "y": "a ruler is better",
    "z": "the map moves with it",
}
DEFAULT_REASON = "the dive does not show it: more turns, heights and overlap are needed"


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
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

    @property
    def significant(self) -> bool:
        """Whether settings change: by more than the standard deviation."""
        return self.observable and abs(self.change) > self.deviation


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        parameters: all, in the order of `PARAMETERS`.
        start, values: (8,) parameters at the start, and with the significant changes.
        view: of the sonar at the start.
        compared: views of the structure, for pictures.
    """

    parameters: tuple[ParameterEstimate, ...]
    start: Floats
    values: Floats
    view: SonarView
    compared: Agreement


def start_of(config: Config) -> tuple[SonarView, Floats]:
    """Return the sonar and the parameters of the settings."""
    angles, position = config.mounting.orientation, config.mounting.position
    view = SonarView(
        quaternion_to_matrix(rotation_from_rpy(angles.roll, angles.pitch, angles.yaw)),
        math.radians(config.sonar.vertical_aperture),
        config.filtering.min_range,
    )
    return view, np.array([0, 0, 0, position.x, position.y, position.z, 0, 1], dtype=np.float64)


def calibrate(
    dive: CalibrationDive, config: Config, progress: Callable[[str], None] = lambda _: None
) -> Calibration:
    """Estimate mounting, time offset and scale of the ranges.

    The floor gives the scale where its nearest point is in the beam, for those echoes have no
    unknown elevation; structure gives the rest.

    Args:
        dive: of a recording.
        config: the settings to start from.
        progress: called with what is done next.
    """
    view, start = start_of(config)
    progress("floor")
    values, deviation = fit_floor(dive, view, floor_echoes(dive, view), start, FLOOR)
    deviations = np.full(len(PARAMETERS), np.inf)
    found, free = start.copy(), STRUCTURE_AND_SCALE
    if deviation[3] <= FLOOR_SCALE_LIMIT and not _astray(values - start):
        found[[0, 7]] = values[[0, 7]]
        deviations[7] = deviation[3]
        free = STRUCTURE
    found, deviations[free] = _fit_structure(dive, view, found, free, progress)
    if astray := _astray(found - start):
        found, deviations = start.copy(), np.full(len(PARAMETERS), np.inf)
        progress(f"the fit of {', '.join(astray)} went astray: nothing is changed")
    parameters = tuple(
        _parameter(name, found[k] - start[k], deviations[k], dive.refitted)
        for k, name in enumerate(PARAMETERS)
    )
    used = np.array([one.change if one.significant else 0.0 for one in parameters]) + start
    last = LAST_WITH_FLOOR[-1].blur
    blur = Blur(last * dive.range_m, last * SINE_PER_RANGE)
    compared = Agreement(
        dive, view, blur, used, side_deg=PICTURE_SIDE_DEG, echoes=ECHOES, seed=SEED
    )
    return Calibration(parameters, start, used, view, compared)


def _fit_structure(
    dive: CalibrationDive,
    view: SonarView,
    values: Floats,
    free: Numbers,
    progress: Callable[[str], None],
) -> tuple[Floats, Floats]:
    """Fit the free parameters; return all, and the deviations of the free ones.

    A surface that curves shows other points to other sides, and so biases the fit: by the square
    of the angle between the views. The difference between stages with other angles shows how much.
    """
    seed, first = SEED, values
    results: list[Floats] = []
    before = values
    last_stages = LAST_WITH_FLOOR if free is STRUCTURE else LAST_WITHOUT_FLOOR
    stages = (*STAGES, *last_stages)
    for number, stage in enumerate(stages):
        progress(f"structure, stage {number + 1} of {len(stages)}")
        if number <= len(STAGES):
            before = np.mean(results[-AVERAGED:], axis=0) if results else values
        results = []
        for _ in range(stage.rounds):
            blur = Blur(stage.blur * dive.range_m, stage.blur * SINE_PER_RANGE)
            agreement = Agreement(
                dive, view, blur, values, side_deg=stage.side_deg, echoes=ECHOES, seed=seed
            )
            seed += 1
            last = values
            values, formal = agreement.improve(values, free, STEPS_OF_ROUND)
            if _astray(values - first):
                return values, np.full(len(free), np.inf)
            results.append(values)
            settled = np.all(np.abs((values - last)[free]) < SETTLED * formal)
            enough = AVERAGED if stage is stages[-1] else 1
            if settled and len(results) > enough:
                break
    mean = np.mean(results[-AVERAGED:], axis=0)
    between = np.std(results[-AVERAGED:], axis=0, ddof=1)[free]
    sides = SIDE_SHARE * (mean - before)[free]
    model = MIN_DEVIATION if free is STRUCTURE else MIN_DEVIATION | WITHOUT_FLOOR
    least = np.array([model[PARAMETERS[k]] for k in free])
    return mean, np.sqrt(formal**2 + between**2 + sides**2 + least**2)


def _astray(change: Floats) -> list[str]:
    """Return the parameters whose change cannot be true."""
    sizes = dict(zip(PARAMETERS, np.abs(change), strict=True))
    return [name for name, largest in PLAUSIBLE.items() if not sizes[name] <= largest]


def _parameter(
    name: str, change: float, deviation: float, refitted: Sequence[str] = ()
) -> ParameterEstimate:
    limit = LIMITS.get(name)
    if name == "time_offset" and refitted:
        reason = (
            f"the clock of {', '.join(refitted)} was fitted again in the recording (clock_off), "
            "as on a busy computer: record again"
        )
        return ParameterEstimate(name, 0.0, deviation, reason)
    if limit is None or not deviation <= limit:
        return ParameterEstimate(name, 0.0, deviation, REASONS.get(name, DEFAULT_REASON))
    return ParameterEstimate(name, float(change), float(deviation))


def yaml_lines(found: Calibration, config: Config, sound_mps: float) -> str:
    """Return the lines of the settings file that put the significant changes into force.

    Args:
        found: the calibration.
        config: the settings it started from.
        sound_mps: speed of sound of the recording.
    """
    changes = {one.name: one.change for one in found.parameters if one.significant}
    lines = []
    turns = [f"{name} {changes[name]:+.2f}" for name in PARAMETERS[:3] if name in changes]
    if turns:
        angles = nearest_angles(found.view.mounting(found.values), config.mounting.orientation)
        roll, pitch, yaw = (round(angle, 2) + 0.0 for angle in angles)
        lines += [
            "mounting:",
            f"  # turned about the vehicle's axes, deg: {', '.join(turns)}",
            f"  orientation: {{ roll: {roll}, pitch: {pitch}, yaw: {yaw} }}",
        ]
    if "range_scale" in changes:
        speed = sound_mps * found.values[7]
        lines += ["water:", f"  speed_of_sound: {speed:.1f}", "  correct_ranges: true"]
    if "time_offset" in changes:
        latency_s = config.device.latency_sec - changes["time_offset"]
        if latency_s >= 0:
            lines += ["device:", f"  latency_sec: {latency_s:.3f}"]
        else:
            lines += [f"# odometry.sources[].latency_sec: add {-latency_s:.3f}"]
    return "\n".join(lines or ["# nothing to change"]) + "\n"


def nearest_angles(mounting: Floats, settings: OrientationConfig) -> tuple[float, float, float]:
    """Return a rotation as roll, pitch and yaw, deg, in the form nearest to the settings.

    Two triples describe each rotation, and infinitely many one whose x axis is vertical: there roll
    stays.

    Args:
        mounting: (3, 3) rotation.
        settings: the angles before.
    """
    before = np.array([settings.roll, settings.pitch, settings.yaw])
    level = math.hypot(mounting[0, 0], mounting[1, 0])
    pitch = math.degrees(math.atan2(-mounting[2, 0], level))
    if level < VERTICAL:
        upright = 1.0 if pitch > 0 else -1.0
        turn = math.degrees(math.atan2(-mounting[0, 1], mounting[1, 1]))
        forms = [np.array([settings.roll, upright * 90.0, turn + upright * settings.roll])]
    else:
        roll = math.degrees(math.atan2(mounting[2, 1], mounting[2, 2]))
        yaw = math.degrees(math.atan2(mounting[1, 0], mounting[0, 0]))
        forms = [np.array([roll, pitch, yaw]), np.array([roll + 180.0, 180.0 - pitch, yaw + 180.0])]
    near = [before + (form - before + 180.0) % 360.0 - 180.0 for form in forms]
    best = min(near, key=lambda form: float(np.abs(form - before).sum()))
    roll, pitch, yaw = ((float(angle) + 180.0) % 360.0 - 180.0 for angle in best)
    return roll, pitch, yaw
