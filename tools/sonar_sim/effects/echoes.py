"""Coarse echoes: a coarse cast of rays and what it hits."""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from sonar_sim.geometry.pose import FramePose
from sonar_sim.raycast.fan import solid_angle_sr
from sonar_sim.raycast.meshes import SEA, Hits, Meshes
from sonar_sim.scene.material import specular_lobe
from sonar_sim.scene.scene import Scene
from sonar_sim.scene.sonar import SonarSettings

SEA_SURFACE = -1
"""Surface number of the sea's surface: the last row of the material table."""
NO_SURFACE = -2
SKIP_M = 1e-3
"""A second cast starts this far behind the first hit, so as not to meet the same face again."""


COLUMNS = 96
COARSE_ELEVATIONS = 100
"""Rays of a column, evenly spaced in the sine of elevation from -1 to 1."""
TOP = 1.0
MIN_AHEAD = 1e-3
"""Sine of the angle to the plane across the sonar below which a ray is ignored."""
GRAZING = 1e-3
"""Cosine of incidence below which a patch has no size worth naming; the kernels have the same."""


@dataclass(frozen=True, slots=True, eq=False)
class CoarseFan:
    """Directions of the coarse rays, uniform in s = -y and w = z as the array hears them.

    Attributes:
        directions: unit vectors, sonar frame, (N, 3).
        column: of the coarse picture, (N,).
        sine_step, up_step: edges of a ray's cell in s and w.
        solid_angle_sr: of each ray's cell, (N,).
        left_sine: where the first column begins.
    """

    directions: NDArray[np.float64]
    column: NDArray[np.int64]
    sine_step: float
    up_step: float
    left_sine: float
    solid_angle_sr: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Echoes:
    """Patches of surface, one a ray that met something in range, and points.

    Attributes:
        column: of the coarse picture, (N,).
        direction: from the sonar, sonar frame, (N, 3).
        point_m: map frame, (N, 3).
        normal: map frame, (N, 3); zero for points.
        range_m: slant range, (N,).
        extent_m: how far the patch reaches in range, (N,).
        surface: place in the scene's surfaces, `SEA_SURFACE`, or NO_SURFACE for points, (N,).
        cos_incidence: 1 for points, (N,).
        lambert_m2: scattering cross section by Lambert's law, (N,); of points, all of it.
        isotropic_m2: the same for isotropic scattering, (N,).
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
    isotropic_m2: NDArray[np.float64]
    lobe_m2: NDArray[np.float64]

    @property
    def up(self) -> NDArray[np.float64]:
        """Sine of the elevation over the fan's plane, (N,)."""
        return self.direction[:, 2]

    def take(self, its: NDArray[np.int64]) -> "Echoes":
        """Some of them, by their places."""
        return Echoes(*(getattr(self, part.name).take(its, axis=0) for part in fields(self)))

    @property
    def section_m2(self) -> NDArray[np.float64]:
        """Cross section of all that the surface does, (N,)."""
        return self.lambert_m2 + self.lobe_m2


def coarse_fan(sonar: SonarSettings) -> CoarseFan:
    """Lay the coarse rays over the fan, from straight below to straight above."""
    edge = math.sin(sonar.half_aperture_rad) + sonar.sine_pitch / 2.0
    sine_step, up_step = 2.0 * edge / COLUMNS, 2.0 * TOP / COARSE_ELEVATIONS
    s = (np.arange(COLUMNS) + 0.5) * sine_step - edge
    w = (np.arange(COARSE_ELEVATIONS) + 0.5) * up_step - TOP
    ss, ww = np.meshgrid(s, w, indexing="ij")
    column = np.broadcast_to(np.arange(COLUMNS)[:, None], ss.shape)
    half_s, half_w = sine_step / 2.0, up_step / 2.0
    solid_angle = solid_angle_sr(ss - half_s, ss + half_s, ww - half_w, ww + half_w)
    # The last cells of a row hold directions only in part, and are looked into there.
    most = np.sqrt(1.0 - ww**2)
    middle = (np.clip(ss - half_s, -most, most) + np.clip(ss + half_s, -most, most)) / 2.0
    ahead = np.sqrt(np.maximum(1.0 - middle**2 - ww**2, 0.0))
    real = (solid_angle > 0.0) & (ahead > MIN_AHEAD)
    directions = np.stack([ahead[real], -middle[real], ww[real]], axis=1)
    return CoarseFan(directions, column[real], sine_step, up_step, -edge, solid_angle[real])


def coarse_echoes(
    scene: Scene,
    sonar: SonarSettings,
    fan: CoarseFan,
    meshes: Meshes,
    hits: Hits,
    *,
    map_T_sonar: FramePose,  # noqa: N803 frames in the name
    time_s: float,
    slack_m: float = 0.0,
) -> Echoes:
    """Give what the rays hit its scattering strengths; what is out of range is left out.

    Args:
        scene: its materials.
        sonar: its range and frequency.
        fan: the rays.
        meshes: the scene's triangles.
        hits: of the rays.
        map_T_sonar: where they start.
        time_s: at which moving objects are met.
        slack_m: what lies so little out of range is taken to be in the last row.
    """
    poses = [np.append(pose.rotation, pose.position_m) for pose in meshes.poses(time_s)]
    ray, point_m, normal, cos_incidence, area_m2, extent_m, turn = meshes.faces.coarse_patches(
        hits.face,
        hits.group,
        hits.range_m,
        fan.directions,
        fan.solid_angle_sr,
        fan.sine_step,
        fan.up_step,
        np.append(map_T_sonar.rotation, map_T_sonar.position_m),
        np.array(poses),
        sonar.range_m + slack_m,
    )
    surface = meshes.surface[hits.face[ray]].astype(np.int64)
    surface[surface == SEA] = SEA_SURFACE
    mu, lobe = _scattering(
        scene, sonar, fan, surface=surface, cos_incidence=cos_incidence, turn=turn
    )
    return Echoes(
        column=fan.column[ray],
        direction=fan.directions.take(ray, axis=0),
        point_m=point_m,
        normal=normal,
        range_m=within_range(sonar, hits.range_m[ray].astype(np.float64)),
        extent_m=extent_m,
        surface=surface,
        cos_incidence=cos_incidence,
        lambert_m2=mu * np.square(cos_incidence) * area_m2,
        isotropic_m2=mu * area_m2,
        lobe_m2=lobe * area_m2,
    )


def within_range(sonar: SonarSettings, range_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranges, the farthest no farther than the last row's middle."""
    last_m = sonar.range_m - 0.5 * sonar.range_resolution_m
    within: NDArray[np.float64] = np.minimum(range_m, last_m)
    return within


def _scattering(
    scene: Scene,
    sonar: SonarSettings,
    fan: CoarseFan,
    *,
    surface: NDArray[np.int64],
    cos_incidence: NDArray[np.float64],
    turn: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lambert's coefficient, and the mirror lobe's scattering per unit area, of each patch.

    `turn` holds the variances of the normal within a patch by its curvature: their sum, their
    product, and the variance along the ray's projection on the tangent plane.
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
    # A round patch holds normals of many slopes, a tube's along one direction only: slopes of
    # covariance S = own 1 + turn, and the lobe is that of the slope which mirrors the ray back,
    # (tan i)² over its variance.
    own = np.square(slope_rad)
    both = np.square(own) + own * turn[:, 0] + turn[:, 1]
    cos2 = np.maximum(np.square(cos_incidence), GRAZING)
    sin2 = np.maximum(1.0 - cos2, GRAZING**2)
    # g S^-1 g = ((own + trace) g² - g turn g) / det S for a direction g of the tangent plane.
    variance = both / np.maximum(own + turn[:, 0] - turn[:, 2] / sin2, 1e-12)
    lobe = specular_lobe(np.cos(incidence), reflection, roughness_m, np.sqrt(variance), wave_number)
    lobe *= variance / np.sqrt(both)
    return mu, np.where(reflection != 0.0, lobe, 0.0)


def is_sea(echoes: Echoes) -> NDArray[np.bool_]:
    """Which echoes are the sea's surface, (N,)."""
    sea: NDArray[np.bool_] = echoes.surface == SEA_SURFACE
    return sea
