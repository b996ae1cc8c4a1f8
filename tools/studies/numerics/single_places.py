"""Single precision in localization, filters, the map stream and exports."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mapperd.client.validation import places_of
from mapperd.config.device import CrosstalkConfig
from mapperd.config.tree import Config
from mapperd.imaging.crosstalk import notched
from mapperd.imaging.ping_image import PingImage
from mapperd.localization.detector import levels_db
from mapperd.localization.models import filter_params
from mapperd.localization.particle_filter import (
    Endpoints,
    Grid,
    HitModel,
    LikelihoodField,
    ParticleFilter,
)
from mapperd.server.state_messages import first_returns
from mapperd.wire.blocks import path_message

__all__ = ["PLACES", "SingleError", "SinglePlace"]


@dataclass(frozen=True, slots=True)
class SingleError:
    """What was found.

    Attributes:
        worst: largest error against double precision or better, with its unit.
        so: what that means for who uses the numbers.
    """

    worst: str
    so: str


@dataclass(frozen=True, slots=True)
class SinglePlace:
    """One of them.

    Attributes:
        where: for people, and the sources of `studies.numerics.sources`.
        what: is single precision there.
        measure: gives the error and its consequence.
        enough: why it does, and what it saves.
        numpy: why the same arithmetic is measured in numpy, where it is not the product's own.
    """

    where: str
    what: str
    measure: Callable[[], SingleError]
    enough: str
    numpy: str = ""


Floats = NDArray[np.float64]
CELLS, EDGE_M = 200, 0.1
HIT = HitModel(z_hit=0.8, z_rand=0.2, sigma_hit_m=0.2, max_range_m=30.0, max_distance_m=2.0)


def _field() -> tuple[LikelihoodField, Floats]:
    """A field, and its values in double precision by scipy's distances."""
    occupancy = np.zeros((CELLS, CELLS), np.int8)
    chance = np.random.default_rng(5)
    occupancy[tuple(chance.integers(0, CELLS, (2, 60)))] = 100
    grid = Grid(occupancy, EDGE_M, np.zeros(3))
    distance = EDGE_M * distance_transform_edt(occupancy == 0)
    exact = np.vectorize(HIT.density)(np.minimum(distance, 2.0))
    return LikelihoodField.of_grid(grid, HIT), exact


def _likelihoods() -> SingleError:
    field, exact = _field()
    off = np.abs(field.values() / exact - 1.0).max()
    return SingleError(
        f"{off:.1e} of a likelihood", f"256 beams: at most {256 * off:.0e} of a weight's log"
    )


def _weighing() -> SingleError:
    """A scan of 256 beams weighed by the field, against the sum of logarithms in doubles."""
    field, _ = _field()
    bearing = np.linspace(-1.1, 1.1, 256)
    ends = 6.0 * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    worst = 0.0
    for place in np.random.default_rng(6).uniform(8.0, 12.0, (50, 2)):
        particles = ParticleFilter(filter_params(Config()), 1)
        particles.start_with(np.array([[*place, 0.0]]))
        scan = Endpoints(np.ascontiguousarray(ends[:, None, :]), np.ones(256))
        got = particles.weigh_field(field, scan, "product").log_evidence
        column, row = np.floor((ends + place) / EDGE_M).astype(int).T
        inside = (column >= 0) & (column < CELLS) & (row >= 0) & (row < CELLS)
        values = np.full(256, field.background)
        values[inside] = field.values()[row[inside], column[inside]]
        exact = math.fsum(np.log(values.astype(np.float64)).tolist())
        worst = max(worst, abs(got - exact))
    return SingleError(f"{worst:.1e} of a weight's log", "a particle's weight is off by that part")


def _levels() -> SingleError:
    """Levels of an image, and means of windows as differences of running sums over 3000 rows."""
    chance = np.random.default_rng(7)
    image = np.minimum(chance.rayleigh(12.0, (3000, 64)), 255.0)
    image[1000:1040] = 255.0
    levels = levels_db(image.astype(np.float32))
    exact = 20.0 * np.log10(np.maximum(image.astype(np.float32).astype(np.float64), 0.5))
    above = levels - np.float32(20.0)
    window = 50
    single = np.cumsum(above, axis=0, dtype=np.float32)
    double = np.cumsum(above, axis=0, dtype=np.float64)
    means = ((single[window:] - single[:-window]) * np.float32(1 / window)).astype(np.float64)
    off = np.abs(means - (double[window:] - double[:-window]) / window).max()
    plain = np.abs(levels - exact)[image >= 1.0].max()
    return SingleError(
        f"{plain:.0e} dB a level, {off:.0e} dB a mean", "a return stands 12 dB above it"
    )


def _notch() -> SingleError:
    chance = np.random.default_rng(8)
    image = np.minimum(chance.rayleigh(20.0, (800, 256)), 255.0).astype(np.float32)
    settings = CrosstalkConfig(filter_strength=0.9)
    off = np.abs(notched(image, settings) - notched(image.astype(np.float64), settings)).max()
    return SingleError(f"{off:.1e} of 255", "a step of an 8-bit image is 1")


def _path() -> SingleError:
    """What a client reads of the points that it receives."""
    lines = []
    for far_m in (10_000.0, 5e6):
        at = np.random.default_rng(9).uniform(-far_m, far_m, (900, 3))
        off = np.abs(places_of(path_message(0, at)) - at).max()
        lines.append(f"{off:.1e} m at {far_m / 1000:.0f} km")
    return SingleError(", ".join(lines), "a path is drawn; poses are in double precision")


def _returns() -> SingleError:
    """One return in each beam, as far as a sonar of low frequency sees."""
    rows, bearings = 2400, np.linspace(-1.1, 1.1, 512)
    image = np.zeros((rows, 512), np.float32)
    row = np.random.default_rng(16).integers(rows // 2, rows, 512)
    image[row, np.arange(512)] = 200.0
    points, _ = first_returns(PingImage(image, bearings, 0.05), Config())
    range_m = (row + 0.5) * 0.05
    exact = range_m[:, None] * np.column_stack([np.cos(bearings), -np.sin(bearings)])
    off = np.abs(points[:, :2] - exact).max()
    return SingleError(f"{off:.1e} m at 120 m", "a row of the image is 2 mm and more")


def _heights() -> SingleError:
    lines = []
    for deep_m in (11_000, 200):
        height = np.random.default_rng(10).uniform(-deep_m, 0.0, 100_000)
        lines.append(f"{np.abs(height.astype(np.float32) - height).max():.0e} m at {deep_m} m")
    return SingleError(", ".join(lines), "a voxel is 5 cm")


def _pictures() -> SingleError:
    """Grey of 16-bit samples at a gamma, as pictures of pings have them."""
    samples = np.arange(2**16, dtype=np.uint16)
    share = np.clip(samples.astype(np.float32) / np.float32(65535.0), 0.0, 1.0)
    grey = np.rint(share ** np.float32(0.6) * 255.0)
    off = np.abs(grey - np.rint((samples / 65535.0) ** 0.6 * 255.0))
    return SingleError(f"{np.sum(off > 0)} of 65536 levels by a grey", "only looked at")


PLACES = (
    SinglePlace(
        "`likelihood_field`",
        "likelihoods of a map's cells",
        _likelihoods,
        "half the memory, twice the cells in a cache; the model's constants are rough guesses",
    ),
    SinglePlace(
        "`field_weight`",
        "likelihoods looked up for a block of particles; products and logarithms are doubles",
        _weighing,
        "particles differ by tenths of a logarithm",
    ),
    SinglePlace(
        "`levels`, `first_return`",
        "levels in dB and running sums of them",
        _levels,
        "a scan is taken of every ping; sums restart in each",
        "means alone, whose running sums lie within the search for a return; levels are ours",
    ),
    SinglePlace(
        "`crosstalk`, `robots`",
        "images while they are filtered; measured of the notch",
        _notch,
        "the samples have 8 or 16 bit",
    ),
    SinglePlace(
        "`stream.way`, particles, `topside`",
        "points of the path",
        _path,
        "12 bytes a point on the link; far away 12 more hold what rounding left",
    ),
    SinglePlace(
        "`stream.pictures`",
        "first returns, fan and bearings",
        _returns,
        "they count from the sonar, not from the map's zero",
    ),
    SinglePlace(
        "GeoTIFF",
        "heights",
        _heights,
        "what survey programs read",
        "the file holds no more than a rounding of each height",
    ),
    SinglePlace(
        "pictures of pings",
        "levels before they are greys",
        _pictures,
        "a screen shows 8 bit",
        "the greys of a picture are mixed with their neighbours at once",
    ),
)
