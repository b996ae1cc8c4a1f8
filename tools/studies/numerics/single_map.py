"""Single precision in the map: what it is given, how it reckons, what it hands out."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mapperd.config.tree import Config
from mapperd.geometry.frames import pose_from_rpy
from mapperd.imaging.ping_image import PingImage, display_units
from mapperd.mapping.queries import MapQueries
from mapperd.mapping.sonar_map import BLOCK_VOXELS, SonarMap
from studies.numerics.growth import UNIT
from studies.numerics.single_places import SingleError, SinglePlace

__all__ = ["PLACES"]

Floats = NDArray[np.float64]
POINTS = 200_000
NOTHING = np.zeros(BLOCK_VOXELS**3)
"""Log-odds of a block that a map does not have."""


def _chance(log_odds: Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + np.exp(-log_odds)))


def _handed_out() -> SingleError:
    """Log-odds that a map of known values is asked for."""
    sonar_map = SonarMap(Config())
    chance = np.random.default_rng(1)
    edge = sonar_map.resolution_m
    points = np.asarray(edge * (chance.integers(-40, 40, (POINTS, 3)) + 0.5), np.float64)
    sonar_map.core.set_log_odds(points, chance.uniform(-10.0, 10.0, POINTS))
    _, units, counts = sonar_map.core.blocks()
    exact = np.sort(units[counts > 0] * UNIT)
    _, given, _ = sonar_map.core.voxels()
    handed = np.sort(given.astype(np.float64))
    off, wrong = np.abs(handed - exact), np.abs(_chance(handed) - _chance(exact))
    return SingleError(f"{off.max():.1e} log-odds", f"probability off by {wrong.max():.0e}")


def _probability() -> SingleError:
    """Of a map's occupied voxels, in the order of the log-odds that they are made of."""
    sonar_map = SonarMap(Config())
    chance = np.random.default_rng(15)
    edge = sonar_map.resolution_m
    points = np.asarray(edge * (chance.integers(-40, 40, (POINTS, 3)) + 0.5), np.float64)
    sonar_map.core.set_log_odds(points, chance.uniform(2.0, 10.0, POINTS))
    _, given, _ = sonar_map.core.voxels()
    exact = np.sort(_chance(given.astype(np.float64)))
    off = np.abs(np.sort(sonar_map.voxels("occupied").probability.astype(np.float64)) - exact)
    return SingleError(f"{off.max():.1e}", "a threshold is met or not by that much")


def _intensity() -> SingleError:
    """Samples of all widths as 0..255."""
    chance = np.random.default_rng(2)
    worst = 0.0
    for bits in (8, 16, 32):
        full = 2**bits - 1
        wide = chance.integers(0, full, POINTS, endpoint=True)
        samples: NDArray[np.unsignedinteger] = wide.astype(f"u{bits // 8}")
        exact = samples.astype(np.float64) / (full / 255)
        worst = max(worst, float(np.abs(display_units(samples, full) - exact).max()))
    settings = Config()
    span = settings.iwlo.intensity_max - settings.filtering.intensity_threshold
    step = settings.iwlo.L_occ * settings.iwlo.sharpness / 4.0 / span * worst
    return SingleError(f"{worst:.1e} of 255", f"a step is off by {step:.0e} log-odds; 8 bit: 0")


def _look_ups() -> SingleError:
    """Everything thrice as large gives the same log-odds, but other roundings on the way."""
    first, second = _scaled(1.0), _scaled(3.0)
    keys = first.keys() | second.keys()
    off = np.array([np.abs(first.get(key, NOTHING) - second.get(key, NOTHING)) for key in keys])
    seen = sum(np.count_nonzero(log_odds) for log_odds in first.values())
    return SingleError(
        f"{off.max():.1e} log-odds",
        f"{np.count_nonzero(off)} of {seen} voxels take the next point of the grid",
    )


def _scaled(scale: float) -> dict[bytes, Floats]:
    """Log-odds by block after one ping of which all lengths are so many times as large."""
    default = Config()
    config = msgspec.structs.replace(
        default,
        octree=msgspec.structs.replace(default.octree, voxel_resolution=0.1 * scale),
        filtering=msgspec.structs.replace(default.filtering, min_range=0.5 * scale),
    )
    bearings = np.linspace(-0.9, 0.9, 128)
    image = np.zeros((200, 128), np.float32)
    chance = np.random.default_rng(3)
    for beam in range(128):
        row = 60 + int(40 * math.sin(beam / 20))
        image[row : row + 12, beam] = chance.uniform(60, 255, 12)
    sonar_map = SonarMap(config)
    pose = pose_from_rpy((0.0, 0.0, 0.0), (7.0, 11.0, 13.0)).map_T_base
    sonar_map.integrate(PingImage(image, bearings, 0.05 * scale), pose)
    keys, units, counts = sonar_map.core.blocks()
    log_odds = np.where(counts > 0, units, 0) * UNIT
    return {key.tobytes(): block for key, block in zip(keys, log_odds, strict=True)}


def _distances() -> SingleError:
    """A distance field of scattered voxels, by scipy's transform in double precision."""
    edge, chance = 0.05, np.random.default_rng(4)
    config = Config()
    sonar_map = SonarMap(
        msgspec.structs.replace(
            config, octree=msgspec.structs.replace(config.octree, voxel_resolution=edge)
        )
    )
    cells = chance.integers(0, 160, (40, 3))
    sonar_map.core.set_log_odds(
        np.asarray(edge * (cells + 0.5), np.float64), np.full(len(cells), 5.0)
    )
    queries = MapQueries(sonar_map.core, occupied_threshold=0.7, free_threshold=0.3)
    got = queries.distance_field((0, 0, 0), (160 * edge,) * 3, 60 * edge).values
    empty = np.ones((160, 160, 160), bool)
    empty[tuple(cells.T)] = False
    exact = edge * distance_transform_edt(empty)
    off = np.abs(got - np.minimum(exact, 60 * edge))
    return SingleError(
        f"{off.max():.1e} m",
        f"of distances up to {min(exact.max(), 60 * edge):.1f} m, in voxels of 5 cm",
    )


PLACES = (
    SinglePlace(
        "`VoxelMap.query`, `voxels`; `.ot` files",
        "log-odds handed out (stored: whole units of 2^-11)",
        _handed_out,
        "the file format's own width; what is stored keeps all its digits",
    ),
    SinglePlace(
        "`mapping.Voxels`, `map_queries`, the client's mirror, LAS",
        "probabilities handed out",
        _probability,
        "thresholds are compared in log-odds, in double precision; half the memory of a cloud",
    ),
    SinglePlace(
        "`echo`",
        "intensities",
        _intensity,
        "samples of 8 bit are exact; 32-bit ones are divided in double precision first",
    ),
    SinglePlace(
        "`evidence_grid`, `kernels`, `iwlo`",
        "shares of a footprint, weights w(I), places of voxels in the grid",
        _look_ups,
        "places count from the sonar, and within a cell from its centre; a point of the grid is "
        "0.3 voxels wide; eight lanes of a vector unit instead of four",
    ),
    SinglePlace(
        "`distance_field`, `volume_map`",
        "distances to the nearest voxel",
        _distances,
        "squares of distances are whole numbers until the last root; half the memory",
    ),
)
