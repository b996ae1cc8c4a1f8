"""The truth behind a ping: what every ray met, and what every pixel shows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.propagation_path import PingGeometry
from sonar_sim.raycast.meshes import NOTHING, Meshes
from sonar_sim.raycast.tracing import Trace
from sonar_sim.scene.material import MIN_COSINE, specular_lobe
from sonar_sim.scene.sonar import SonarSettings

MIN_RANGE_M = 0.01
MIN_AHEAD = 0.03
"""Straight above and below, where the directions ahead end: what a cell there has on average."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Of the rays that met something, (N, ...), and of the pixels, (rows, beams, ...).

    A pixel shows the surface whose echo is the strongest in it, in the beam's own direction: of
    those that send something back, by mean power. Materials are the surfaces'.

    Attributes:
        ray_direction: unit vectors, sonar frame, (N, 3).
        ray_range_m: slant ranges, (N,).
        ray_surface: indices into `Scene.surfaces`, or `meshes.SEA`, (N,).
        ray_normal: unit normals on the sonar's side, map frame, (N, 3).
        ray_elevation_rad: above the fan's plane, (N,).
        ray_incidence_rad: from the normal, (N,).
        range_m: as above, of each pixel; NaN where nothing is.
        surface: `meshes.NOTHING` where nothing is.
        normal, elevation_rad, incidence_rad: NaN where nothing is.
    """

    ray_direction: NDArray[np.float32]
    ray_range_m: NDArray[np.float32]
    ray_surface: NDArray[np.int32]
    ray_normal: NDArray[np.float32]
    ray_elevation_rad: NDArray[np.float32]
    ray_incidence_rad: NDArray[np.float32]
    range_m: NDArray[np.float32]
    surface: NDArray[np.int32]
    normal: NDArray[np.float32]
    elevation_rad: NDArray[np.float32]
    incidence_rad: NDArray[np.float32]


def truth_of(
    rays: Trace, meshes: Meshes, sonar: SonarSettings, here: PingGeometry, wavelength_m: float
) -> Truth:
    """Work out a ping's truth; apparent ranges count for the rows."""
    met = rays.met[0]
    hit = np.flatnonzero(met.face >= 0)
    turns = np.stack([frame.rotation for frame in meshes.poses(here.time_s)])
    normal = np.einsum("nij,nj->ni", turns[met.group[hit]], meshes.planes[met.face[hit], :3])
    facing = np.einsum("ij,ij->i", normal, rays.direction[hit])
    normal *= -np.sign(facing)[:, None]
    direction = rays.fan.directions[hit]
    elevation = np.arcsin(direction[:, 2])
    incidence = np.arccos(np.clip(np.abs(facing), 0.0, 1.0))
    range_m = met.range_m[hit]
    surface = meshes.surface[met.face[hit]]
    power = _power(rays, meshes, here, hit=hit, facing=np.abs(facing), wavelength_m=wavelength_m)
    apparent_m, turn = range_m * here.physics.range_scale, here.pose.rotation
    reach_m = _reach(rays, hit, normal @ turn, np.abs(facing), apparent_m)
    owner = _owners(rays, hit, reach_m, apparent_m, power=power, sonar=sonar)
    empty = owner == NOTHING

    def pick(values: NDArray[np.floating]) -> NDArray[np.float32]:
        picked = np.full((*owner.shape, *values.shape[1:]), np.nan, dtype=np.float32)
        picked[~empty] = values[owner[~empty]]
        return picked

    shown = np.full(owner.shape, NOTHING, dtype=np.int32)
    shown[~empty] = surface[owner[~empty]]
    rows_m = np.where(empty, np.nan, sonar.row_centres_m[:, None] / here.physics.range_scale)
    return Truth(
        direction,
        range_m,
        surface,
        normal.astype(np.float32),
        elevation,
        incidence.astype(np.float32),
        rows_m.astype(np.float32),
        shown,
        pick(normal),
        pick(elevation),
        pick(incidence),
    )


def _power(
    rays: Trace,
    meshes: Meshes,
    here: PingGeometry,
    *,
    hit: NDArray[np.int64],
    facing: NDArray[np.float64],
    wavelength_m: float,
) -> NDArray[np.float64]:
    """Mean power of each hit's echo, all rows together, up to a factor of the ping; 0: silent."""
    physics, face = here.physics, rays.met[0].face[hit]
    mu, reflection2, roughness_m, slope_rad = meshes.strengths[meshes.material[face]].T
    strength = mu * (np.square(facing) if physics.lambert else 1.0)
    if physics.specular:
        wave_number_per_m = 2.0 * np.pi / wavelength_m
        strength = strength + specular_lobe(
            facing, np.sqrt(reflection2), roughness_m, slope_rad, wave_number_per_m
        )
    range_m = np.maximum(rays.met[0].range_m[hit].astype(np.float64), MIN_RANGE_M)
    power = strength * rays.fan.solid_angle_sr[hit] / np.maximum(facing, MIN_COSINE)
    power /= np.square(range_m)
    power *= 10.0 ** (-0.2 * physics.attenuation_db_per_m * range_m)
    if physics.vertical_width_rad is not None:
        up = rays.fan.directions[hit, 2].astype(np.float64)
        power *= vertical_two_way_power(up, physics.vertical_width_rad)
    heard: NDArray[np.float64] = power * here.echoes(face)
    return heard


def _owners(
    rays: Trace,
    hit: NDArray[np.int64],
    reach_m: NDArray[np.float64],
    apparent_m: NDArray[np.float32],
    *,
    power: NDArray[np.float64],
    sonar: SonarSettings,
) -> NDArray[np.int64]:
    """Which hit each pixel shows, (rows, beams): the strongest of those whose cells cover it."""
    beam = rays.fan.column[hit] - (rays.fan.columns - sonar.beams) // 2
    half = 0.5 * reach_m / sonar.range_resolution_m
    middle = apparent_m / sonar.range_resolution_m
    first = np.clip(np.floor(middle - half), 0, sonar.rows).astype(np.int64)
    last = np.clip(np.floor(middle + half) + 1, 0, sonar.rows).astype(np.int64)
    inside = (beam >= 0) & (beam < sonar.beams) & (power > 0.0)
    count = np.where(inside, np.maximum(last - first, 0), 0)
    # A cell that reaches over many rows gives each of them a part of its power.
    order = np.argsort(power / np.maximum(2.0 * half, 1.0), kind="stable")
    which = np.repeat(order, count[order])
    ends = np.cumsum(count[order])
    row = np.arange(len(which)) - np.repeat(ends - count[order], count[order]) + first[which]
    owner = np.full((sonar.rows, sonar.beams), NOTHING, dtype=np.int64)
    owner[row, beam[which]] = which
    return owner


def _reach(
    rays: Trace,
    hit: NDArray[np.int64],
    normal: NDArray[np.float64],
    facing: NDArray[np.float64],
    range_m: NDArray[np.float32],
) -> NDArray[np.float64]:
    """How far a hit's cell reaches in range over its plane: dR = R (n.dd) / (n.d) along w.

    Normals are in the sonar's frame.
    """
    cell = rays.fan.cell[hit].astype(np.float64)
    x, _, z = rays.fan.directions[hit].T.astype(np.float64)
    x = np.maximum(x, MIN_AHEAD)
    tilt = np.abs(normal[:, 2] - normal[:, 0] * z / x)
    along = range_m / np.maximum(facing, 1e-3) * tilt * (cell[:, 3] - cell[:, 2])
    reach: NDArray[np.float64] = np.minimum(along, 0.5 * range_m)
    return reach
