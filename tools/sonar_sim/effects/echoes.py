"""Echoes of the coarse cast: where they come from, and how strongly they scatter."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.rays import SEA, Met
from sonar_sim.lobe import lobe_strength
from sonar_sim.poses import Pose
from sonar_sim.scene import Scene
from sonar_sim.sonar import SonarSettings

COLUMNS = 96
ELEVATIONS = 64
TOP = math.sin(math.radians(40.0))
"""Sine of the highest elevation: out to the vertical pattern's second lobe."""
GRAZING = 1e-3
"""Cosine of incidence below which a patch has no size worth naming."""


@dataclass(frozen=True, slots=True, eq=False)
class Fan:
    """Directions of the coarse rays, uniform in s = -y and w = z as the array hears them.

    Attributes:
        directions: unit vectors, sonar frame, (N, 3).
        column: of the coarse picture, (N,).
        sine_step, up_step: edges of a ray's cell in s and w.
        left_sine: where the first column begins.
    """

    directions: NDArray[np.float64]
    column: NDArray[np.int64]
    sine_step: float
    up_step: float
    left_sine: float


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Patches of surface, one a ray that met something in range, and points.

    Attributes:
        column: of the coarse picture, (N,).
        direction: from the sonar, sonar frame, (N, 3).
        point_m: map frame, (N, 3).
        normal: map frame, (N, 3); zero for points.
        range_m: slant range, (N,).
        extent_m: how far the patch reaches in range, (N,).
        surface: place in the scene's surfaces, `SEA`, or NOTHING for points, (N,).
        cos_incidence: 1 for points, (N,).
        lambert_m2: scattering cross section by Lambert's law, (N,); of points, all of it.
        even_m2: the same if the surface scattered alike in all directions, (N,).
        lobe_m2: cross section of the mirror's lobe, (N,).
    """

    column: NDArray[np.int64]
    direction: NDArray[np.float64]
    point_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    range_m: NDArray[np.float64]
    extent_m: NDArray[np.float64]
    surface: NDArray[np.int64]
    cos_incidence: NDArray[np.float64]
    lambert_m2: NDArray[np.float64]
    even_m2: NDArray[np.float64]
    lobe_m2: NDArray[np.float64]

    @property
    def up(self) -> NDArray[np.float64]:
        """Sine of the elevation over the fan's plane, (N,)."""
        return self.direction[:, 2]

    @property
    def section_m2(self) -> NDArray[np.float64]:
        """Cross section of all that the surface does, (N,)."""
        return self.lambert_m2 + self.lobe_m2


def coarse_fan(sonar: SonarSettings) -> Fan:
    """Lay the coarse rays over the fan and the vertical pattern's two lobes."""
    edge = math.sin(sonar.half_aperture_rad) + sonar.sine_pitch / 2.0
    sine_step, up_step = 2.0 * edge / COLUMNS, 2.0 * TOP / ELEVATIONS
    s = (np.arange(COLUMNS) + 0.5) * sine_step - edge
    w = (np.arange(ELEVATIONS) + 0.5) * up_step - TOP
    ss, ww = np.meshgrid(s, w, indexing="ij")
    column = np.broadcast_to(np.arange(COLUMNS)[:, None], ss.shape)
    ahead = 1.0 - ss**2 - ww**2
    real = ahead > sine_step**2
    directions = np.stack([np.sqrt(ahead[real]), -ss[real], ww[real]], axis=1)
    return Fan(directions, column[real], sine_step, up_step, -edge)


def echoes_of(
    scene: Scene,
    sonar: SonarSettings,
    fan: Fan,
    map_T_sonar: Pose,  # noqa: N803 frames in the name
    met: Met,
) -> Echoes:
    """Give what the rays met its scattering strengths; what is out of range is left out."""
    near = np.flatnonzero(met.range_m < sonar.range_m)
    direction, range_m, normal = fan.directions[near], met.range_m[near], met.normal[near]
    local = normal @ map_T_sonar.rotation
    cos_incidence = np.abs(np.sum(local * direction, axis=1))
    facing = np.maximum(cos_incidence, GRAZING)
    area_m2 = np.square(range_m) * fan.sine_step * fan.up_step / (direction[:, 0] * facing)
    turn = met.turn[near] * (np.square(range_m * fan.up_step / math.sqrt(12.0))[:, None] ** [1, 2])
    surface = met.surface[near]
    mu, lobe = _scattering(
        scene, sonar, fan, surface=surface, cos_incidence=cos_incidence, turn=turn
    )
    return Echoes(
        column=fan.column[near],
        direction=direction,
        point_m=(direction * range_m[:, None]) @ map_T_sonar.rotation.T + map_T_sonar.position_m,
        normal=normal,
        range_m=range_m,
        extent_m=_extent_m(direction, local, range_m, facing, fan),
        surface=surface,
        cos_incidence=cos_incidence,
        lambert_m2=mu * np.square(cos_incidence) * area_m2,
        even_m2=mu * area_m2,
        lobe_m2=lobe * area_m2,
    )


def _scattering(
    scene: Scene,
    sonar: SonarSettings,
    fan: Fan,
    *,
    surface: NDArray[np.int64],
    cos_incidence: NDArray[np.float64],
    turn: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lambert's coefficient, and the mirror lobe's scattering per unit area, of each patch.

    `turn` holds the variances of the normal within a patch by its curvature: sum and product.
    """
    wave_number = 2.0 * math.pi * sonar.frequency_hz / scene.water.speed_of_sound_mps
    materials = [s.material for s in scene.surfaces]
    sea_mu = 10.0 ** (scene.sea.lambert_db / 10.0) if scene.sea is not None else 0.0
    # The sea's surface is number -1: the last entry.
    table = np.array(
        [(m.mu, m.reflection, m.roughness_m, m.slope_rad) for m in materials]
        + [(sea_mu, 0.0, 1.0, 1.0)]
    )
    mu, reflection, roughness_m, slope_rad = table[surface].T
    # A patch is as bright as its brightest part: the lobe may be narrower than a coarse cell.
    reach = max(fan.sine_step, fan.up_step) / 2.0
    incidence = np.maximum(np.arccos(np.clip(cos_incidence, 0.0, 1.0)) - reach, 0.0)
    # A round patch holds normals of many slopes: as many, on average, as one that is so rough.
    own = np.square(slope_rad)
    both = np.square(own) + own * turn[:, 0] + turn[:, 1]
    lobe = lobe_strength(
        np.cos(incidence), reflection, roughness_m, np.sqrt(own + turn[:, 0]), wave_number
    )
    lobe *= (own + turn[:, 0]) / np.sqrt(both)
    return mu, np.where(reflection != 0.0, lobe, 0.0)


def _extent_m(
    direction: NDArray[np.float64],
    normal: NDArray[np.float64],
    range_m: NDArray[np.float64],
    facing: NDArray[np.float64],
    fan: Fan,
) -> NDArray[np.float64]:
    """How far a ray's cell reaches in range over its patch's plane: dR = -R (n.dd) / (n.d)."""
    x, y, z = direction.T
    nx, ny, nz = normal.T
    across = np.abs(nx * y / x - ny) * fan.sine_step
    along = np.abs(nz - nx * z / x) * fan.up_step
    extent: NDArray[np.float64] = np.minimum(range_m / facing * (across + along), range_m)
    return extent


def is_sea(echoes: Echoes) -> NDArray[np.bool_]:
    """Which echoes are the sea's surface, (N,)."""
    sea: NDArray[np.bool_] = echoes.surface == SEA
    return sea
