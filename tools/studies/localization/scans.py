"""Scans of a dive without its pings: ranges cast in the scene, with the errors that scans have.

`tools/studies/scan_truth.py` measures the errors of scans of simulated pings: the share of returns
on the first surface that the beam looks at, on one beside it, above or below it, or elsewhere.
Here each beam's return is drawn by these shares, of surfaces that are cast there: so the errors are
alike in kind, and lie together where a pile or a hull is beside the beam.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sonar_sim.geometry.pose import rotation_of

from mapperd.localization.extraction import floor_gate_m
from mapperd.localization.scan import Scan, fan_points
from studies.localization.world import DiveWorld

__all__ = ["Shares", "cast_scan"]

Floats = NDArray[np.float64]

BEAMS = 171
"""Every third of 512: as many returns as a scan is decimated to."""

NEAR_OFFSETS = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
BESIDE_OFFSETS = np.array([-2.0, -1.0, 1.0, 2.0])
"""In beam widths from the beam's middle."""

ELEVATIONS = 13
STEEP = 1.8
"""Rays in the aperture, and in apertures how far above and below something is still heard."""

SOFT_REACH = 0.15
"""Floor and sea are heard from where they come into the aperture up to so much farther."""

MIN_M = 0.5
QUALITY, QUALITY_SIGMA, FLOOR_QUALITY = 0.70, 0.05, 0.3


@dataclass(frozen=True, slots=True)
class Shares:
    """Of the beams that look at a surface nearer than floor and sea, and of their returns.

    Attributes:
        heard: of those beams have a return.
        heard_floor: of the beams that look at floor or sea alone.
        beside: of the returns stand on a surface within three beam widths.
        steep: on one within 1.8 times the aperture.
        elsewhere: anywhere up to the range.
    """

    heard: float = 0.78
    heard_floor: float = 0.05
    beside: float = 0.10
    steep: float = 0.03
    elsewhere: float = 0.01


SHARES = {"tank": Shares(1.0, 1.0, 0.03, 0.0, 0.01)}
"""Of scenes that differ from the harbour."""


def cast_scan(world: DiveWorld, place: Floats, stamp_ns: int, random: np.random.Generator) -> Scan:
    """One scan.

    Args:
        world: what the rays meet.
        place: (6,) x, y, z, roll, pitch, yaw of the sonar, map frame.
        stamp_ns: of the scan.
        random: draws the errors.
    """
    sonar, where, shares = (
        world.scenario.sonar,
        world.place,
        SHARES.get(world.place.scene, Shares()),
    )
    bearing = np.arcsin(np.linspace(-1, 1, BEAMS) * math.sin(sonar.half_aperture_rad))
    map_R_sonar = rotation_of(*place[3:])  # noqa: N806 frames are named
    row_m = sonar.range_m / sonar.rows
    near, beside, steep, soft = _surfaces(world, place[:3], map_R_sonar, bearing)
    level = np.eye(4)
    level[:3, :3] = rotation_of(place[3], place[4], 0.0)
    gate = floor_gate_m(
        bearing,
        level,
        sonar.vertical_width_rad,
        height_m=place[2] - where.floor_m,
        depth_m=-place[2],
    )
    ahead = np.isfinite(near[:, len(NEAR_OFFSETS) // 2])
    columns = np.arange(BEAMS)
    range_m = near[columns, random.integers(near.shape[1], size=BEAMS)]
    kind = random.uniform(size=BEAMS)
    drawn = beside[columns, random.integers(beside.shape[1], size=BEAMS)]
    limits = np.cumsum([shares.beside, shares.steep, shares.elsewhere])
    range_m = np.where(kind < limits[0], drawn, range_m)
    range_m = np.where((kind >= limits[0]) & (kind < limits[1]), steep, range_m)
    anywhere = random.uniform(MIN_M, sonar.range_m, BEAMS)
    range_m = np.where((kind >= limits[1]) & (kind < limits[2]), anywhere, range_m)
    reach = random.uniform(0.0, SOFT_REACH, BEAMS)
    range_m = np.where(ahead, range_m, soft * (1.0 + reach))
    range_m = range_m + random.uniform(-row_m, row_m, BEAMS)
    heard = random.uniform(size=BEAMS) < np.where(ahead, shares.heard, shares.heard_floor)
    heard &= (range_m > MIN_M) & (range_m < sonar.range_m)
    beam = np.flatnonzero(heard)
    quality = np.clip(random.normal(QUALITY, QUALITY_SIGMA, len(beam)), 0.0, 1.0)
    quality *= np.where(range_m[beam] >= gate[beam], FLOOR_QUALITY, 1.0)
    return Scan(
        stamp_ns,
        bearing[beam],
        range_m[beam],
        fan_points(range_m[beam], bearing[beam], level),
        quality,
        beam,
        bearing[~heard],
        sonar.range_m,
        level,
    )


def _surfaces(
    world: DiveWorld,
    origin_m: Floats,
    map_R_sonar: Floats,  # noqa: N803 frames are named
    bearing: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """First ranges within the beam (B, 5), beside it (B, 4), and above and below it (B,).

    Of things, that is: floor and sea, at grazing incidence, are faint before them. Their own first
    ranges in the beam are the last (B,). Infinite without a return.
    """
    sonar = world.scenario.sonar
    width_rad = math.radians(world.place.beam_width_deg)
    half = sonar.vertical_width_rad / 2
    inner = np.linspace(-half, half, ELEVATIONS)
    outer = np.linspace(-STEEP * half, STEEP * half, ELEVATIONS)
    offsets = np.concatenate([NEAR_OFFSETS, BESIDE_OFFSETS])
    fans = [(offset * width_rad, inner) for offset in offsets] + [(0.0, outer)]
    parts = [_cones(bearing + offset, elevation) for offset, elevation in fans]
    directions = np.stack(parts, axis=1)
    rays = (directions.reshape(-1, 3) @ map_R_sonar.T).astype(np.float32)
    met = world.meshes.cast(origin_m, rays, 0.0, float(sonar.range_m), threads=1)
    ranges = np.where(met.face < 0, np.inf, met.range_m).astype(np.float64)
    is_soft = np.isin(world.meshes.surface[met.face], world.soft)
    shape = directions.shape[:3]
    first = np.where(is_soft, np.inf, ranges).reshape(shape).min(axis=2)
    soft = np.where(is_soft, ranges, np.inf).reshape(shape).min(axis=2)
    count = len(NEAR_OFFSETS)
    return first[:, :count], first[:, count:-1], first[:, -1], soft[:, count // 2]


def _cones(bearing: Floats, elevation: Floats) -> Floats:
    """(B, E, 3) directions on the beams' cones, sonar frame."""
    sine = np.clip(np.sin(bearing), -0.999, 0.999)[:, None]
    edge = np.sqrt(1.0 - sine**2)
    up = np.clip(np.sin(elevation)[None, :], -edge, edge)
    ahead = np.sqrt(np.maximum(1.0 - sine**2 - up**2, 0.0))
    return np.stack([ahead, np.broadcast_to(-sine, ahead.shape), up], axis=-1)
