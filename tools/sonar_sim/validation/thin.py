"""Validation of thin objects: a rope, a strip and a ball at random places in the fan (V21).

Each is narrower than the pitch of the rays, so that most places lie between them.
"""

import dataclasses
import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.scene.scene import Scene, Surface
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.setups import CHALK, MEAN, cell_power, rectangle, sphere

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PLACES = 24
ASIDE = 0.9
"""Of the half aperture, within which places lie."""
UP_RAD, ROLL_RAD = math.radians(8.0), math.radians(6.0)
ROPE_M, ROPE_AT_M, ROPE_LONG_M = 0.016, 8.0, 2.0
STRIP_M, STRIP_AT_M, STRIP_LONG_M = 0.01, 10.0, 1.0
BALL_M, BALL_AT_M = 0.05, 12.0


@dataclass(frozen=True, eq=False)
class ThinObject:
    """One object and what it must send back.

    Attributes:
        name: with its size.
        scene: with the object ahead of the map's origin.
        sonar: 256 beams.
        power: of all cells, over the source's at 1 m: the integral of mu cos² i / R⁴ over it.
    """

    name: str
    scene: Scene
    sonar: SonarSettings
    power: float


def thin_objects() -> tuple[ThinObject, ...]:
    """The rope, the strip and balls of 5 cm radius and of 5 cm diameter."""
    wide = SonarSettings(beams=256, demanded_range_m=11.0, forced_rows=500)
    narrow = dataclasses.replace(wide, half_aperture_rad=math.radians(15.0), demanded_range_m=13.0)
    strip = rectangle((STRIP_AT_M, 0, 0), (0, STRIP_M, 0), (0, 0, STRIP_LONG_M), CHALK)
    balls = [
        ThinObject(
            f"ball of {200.0 * radius_m:g} cm at {BALL_AT_M:g} m, 30° fan",
            Scene((sphere((BALL_AT_M, 0.0, 0.0), radius_m, CHALK),)),
            narrow,
            _ball_power(radius_m),
        )
        for radius_m in (BALL_M, BALL_M / 2.0)
    ]
    return (
        ThinObject("rope of 16 mm at 8 m", Scene((_rope(),)), wide, _rope_power()),
        ThinObject("strip of 1 cm at 10 m", Scene((strip,)), wide, _strip_power()),
        *balls,
    )


def places(sonar: SonarSettings, count: int, seed: int = 0) -> list[FramePose]:
    """Poses at the origin from which what is ahead lies anywhere in the fan."""
    random = np.random.default_rng(seed)
    half = math.sin(ASIDE * sonar.half_aperture_rad)
    yaw = np.arcsin(random.uniform(-half, half, count))
    pitch = random.uniform(-UP_RAD, UP_RAD, count)
    roll = random.uniform(-ROLL_RAD, ROLL_RAD, count)
    turns = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
    return [FramePose(np.zeros(3), turn) for turn in turns]


def errors_db(thin: ThinObject, poses: list[FramePose]) -> NDArray[np.float64]:
    """Level of the mean echo against what it must be, (P,); -inf where the object is lost."""
    engine = PingEngine(thin.scene, thin.sonar)
    power = np.array([cell_power(engine, pose, MEAN).sum() for pose in poses])
    with np.errstate(divide="ignore"):
        level: NDArray[np.float64] = 10.0 * np.log10(power / thin.power)
    return level


def speckled_powers(
    thin: ThinObject, poses: list[FramePose], first_seed: int = 0
) -> NDArray[np.float64]:
    """Power of the brightest pixel of speckle over its mean, by a seed of each pose's own, (P,).

    The beams' pattern and the range response are on, as for a sonar.
    """
    engine, sonar = PingEngine(thin.scene, thin.sonar), thin.sonar
    heard = dataclasses.replace(
        MEAN,
        beam_width_rad=sonar.beam_width_rad,
        side_lobe_db=sonar.side_lobe_db,
        range_spread=True,
    )
    powers = []
    for seed, pose in enumerate(poses, first_seed):
        mean = cell_power(engine, pose, heard)
        field = cell_power(engine.reseeded(seed), pose, dataclasses.replace(heard, speckle=True))
        brightest = np.unravel_index(int(mean.argmax()), mean.shape)
        powers.append(field[brightest] / mean[brightest])
    return np.array(powers)


def v21_thin_objects() -> ValidationResult:
    """No object is too thin to be met, wherever it lies."""
    objects = thin_objects()
    levels = {o.name: errors_db(o, places(o.sonar, PLACES)) for o in objects}
    checks = [
        ValidationCheck(f"{name}, {what} of {PLACES} places, dB", 0.0, float(worst), 0.5)
        for name, level in levels.items()
        for what, worst in (("faintest", level.min()), ("loudest", level.max()))
    ]
    return ValidationResult(
        "V21 thin objects", "sum of mu cos² i dA / R⁴", tuple(checks), partial(_draw, levels)
    )


def _draw(levels: dict[str, NDArray[np.float64]], axes: "Axes") -> None:
    for name, level in levels.items():
        axes.plot(np.sort(level), ".", ms=3, label=name)
    axes.set_ylim(-1.0, 1.0)
    axes.set_xlabel("place, by level")
    axes.set_ylabel("mean echo against theory, dB")
    axes.legend(fontsize=6)


def _rope() -> Surface:
    """A tube of 24 sides without ends, upright."""
    turn = np.arange(24) * (2.0 * math.pi / 24)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * ROPE_M / 2.0
    height_m = np.array([-0.5, 0.5]) * ROPE_LONG_M
    points = np.array([[ROPE_AT_M + x, y, z] for z in height_m for x, y in ring])
    low = np.arange(24)
    beside = (low + 1) % 24
    faces = np.concatenate(
        [np.stack([low, beside, beside + 24], 1), np.stack([low, beside + 24, low + 24], 1)]
    )
    return Surface("rope", points, faces.astype(np.int64), CHALK, smooth=True)


def _rope_power() -> float:
    radius_m = ROPE_M / 2.0
    z, turn = np.meshgrid(
        np.linspace(-0.5, 0.5, 801) * ROPE_LONG_M,
        np.linspace(-0.5, 0.5, 801) * math.pi,
        indexing="ij",
    )
    x, y = ROPE_AT_M - radius_m * np.cos(turn), radius_m * np.sin(turn)
    squares = x**2 + y**2 + z**2
    cosine = np.maximum(x * np.cos(turn) - y * np.sin(turn), 0.0) / np.sqrt(squares)
    by_height = np.trapezoid(cosine**2 / squares**2, turn, axis=1)
    return float(CHALK.mu * radius_m * np.trapezoid(by_height, z[:, 0]))


def _strip_power() -> float:
    z = np.linspace(-0.5, 0.5, 2001) * STRIP_LONG_M
    squares = STRIP_AT_M**2 + z**2
    return float(CHALK.mu * STRIP_M * np.trapezoid(STRIP_AT_M**2 / squares**3, z))


def _ball_power(radius_m: float) -> float:
    turn = np.linspace(0.0, math.acos(radius_m / BALL_AT_M), 20001)
    squares = BALL_AT_M**2 + radius_m**2 - 2.0 * radius_m * BALL_AT_M * np.cos(turn)
    cosine = (BALL_AT_M * np.cos(turn) - radius_m) / np.sqrt(squares)
    ring = 2.0 * math.pi * radius_m**2 * np.sin(turn)
    return float(CHALK.mu * np.trapezoid(cosine**2 * ring / squares**2, turn))
