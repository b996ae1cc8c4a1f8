"""Scenes and receivers that several validation cases share."""

import math

import numpy as np
import trimesh
from numpy.typing import NDArray

from sonar_sim.engine import PingEngine
from sonar_sim.geometry.pose import FramePose
from sonar_sim.propagation.physics import Physics
from sonar_sim.receiver.beamformer import BeamFormer, beam_former
from sonar_sim.receiver.gain import FULL_SCALE_DB
from sonar_sim.receiver.noise import add_random, stream_key
from sonar_sim.scene.material import Material
from sonar_sim.scene.scene import PointTarget, Scene, Surface
from sonar_sim.scene.sonar import SonarSettings

Vector = tuple[float, float, float]
DULL = Material("dull", -27.0)
CHALK = Material("chalk", -10.0)
MIRROR = Material("mirror", -200.0, reflection=1.0, roughness_m=0.0, slope_rad=0.01)
MEAN = Physics(spreading=True, lambert=True, specular=True, shadows=True, sine_bearings=True)
"""Mean powers, nothing but geometry and scattering; each echo in its own cell."""


def pose_at(position_m: Vector) -> FramePose:
    """Level, looking along +x."""
    return FramePose(np.array(position_m), np.eye(3))


def narrow_sonar(range_m: float, row_m: float = 0.004, beams: int = 64) -> SonarSettings:
    """A small fan of fine rows."""
    return SonarSettings(
        beams=beams,
        half_aperture_rad=math.radians(15.0),
        demanded_range_m=range_m,
        forced_rows=round(range_m / row_m),
    )


def rectangle(
    centre: Vector, edge_u: Vector, edge_v: Vector, material: Material = DULL, cuts: int = 1
) -> Surface:
    """A rectangle in 2 cuts² triangles."""
    steps = np.linspace(-0.5, 0.5, cuts + 1)
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps, indexing="ij"))
    points = np.array(centre) + u * np.array(edge_u) + v * np.array(edge_v)
    index = np.arange((cuts + 1) ** 2).reshape(cuts + 1, cuts + 1)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Surface("rectangle", points, faces.astype(np.int64), material)


def sphere(centre: Vector, radius_m: float, material: Material) -> Surface:
    """A round sphere of 20480 triangles."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius_m)
    points = np.asarray(mesh.vertices) + np.array(centre)
    return Surface("sphere", points, np.asarray(mesh.faces, np.int64), material, smooth=True)


def floor(height_m: float = 0.0, material: Material = DULL) -> Surface:
    """A floor of 400 m by 400 m about the origin."""
    return rectangle((0.0, 0.0, height_m), (400.0, 0.0, 0.0), (0.0, 400.0, 0.0), material)


def target(position_m: Vector, name: str = "target") -> PointTarget:
    """A point target of 0 dB."""
    return PointTarget(name, position_m, 0.0)


def cell_power(engine: PingEngine, pose: FramePose, physics: Physics) -> NDArray[np.float64]:
    """Echo power over the source's at 1 m, (rows, beams)."""
    shown = engine.ping(pose, physics).amplitude.astype(np.float64)
    level = 10.0 ** ((FULL_SCALE_DB - engine.sonar.source_level_db) / 10.0)
    power: NDArray[np.float64] = np.square(shown) * level
    return power


def power_of(
    scene: Scene, sonar: SonarSettings, pose: FramePose, physics: Physics = MEAN
) -> NDArray[np.float64]:
    """`cell_power` of a scene seen once."""
    return cell_power(PingEngine(scene, sonar), pose, physics)


def decibel(power: float) -> float:
    """10 log of a power."""
    return float(10.0 * np.log10(max(power, 1e-300)))


def centre_row_mean(power: NDArray[np.float64], sonar: SonarSettings, range_m: float) -> float:
    """Mean over some rows about a range, of the middle beams."""
    row = round(range_m / sonar.range_resolution_m)
    middle = power.shape[1] // 2
    return float(power[row - 8 : row + 8, middle - 2 : middle + 2].mean())


MARGIN = 24
"""Columns beyond the outermost beams, so that those hear as much as the middle."""


class Homogeneous:
    """Fully developed speckle of one level, frozen, and noise that is new in every ping.

    Args:
        sonar: for the beams.
        rows: of the sheet.
        physics: beam width, side lobes and range spread are obeyed.
        seed: of the scatterers.
    """

    def __init__(
        self, sonar: SonarSettings, rows: int, physics: Physics | None = None, seed: int = 0
    ) -> None:
        self.physics = physics or Physics(
            beam_width_rad=sonar.beam_width_rad,
            side_lobe_db=sonar.side_lobe_db,
            range_spread=True,
            sine_bearings=True,
        )
        self._rows = rows
        self._columns = sonar.beams + 2 * MARGIN
        self._seed = seed
        self.former: BeamFormer = beam_former(sonar, self.physics, MARGIN)

    def beams(
        self, ping_id: int = 0, signal_db: float = 0.0, noise_db: float = -math.inf
    ) -> NDArray[np.complex64]:
        """What the beams hear, (rows, beams).

        Args:
            ping_id: of the noise.
            signal_db: mean level of the echo in a beam.
            noise_db: of the noise in a beam.
        """
        field = np.zeros((self._rows, self._columns), dtype=np.complex64)
        everywhere = np.ones(self._columns, dtype=np.float32)
        for level_db, key in (
            (signal_db, stream_key(self._seed, "surface")),
            (noise_db, stream_key(self._seed, "noise", ping_id)),
        ):
            rms = 10.0 ** (level_db / 20.0) / self.former.noise_gain
            add_random(field, np.full(self._rows, rms, dtype=np.float32), everywhere, key)
        return self.former.form(field)
