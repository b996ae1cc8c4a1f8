"""The arc rule: maps in which the level of an echo tells where on its arc it comes from.

The core integrates levels relative to that of a surface on the beam's axis
(`cpp/map/include/mapperd/map/arc_model.hpp` has the definition). `SurfaceLevel` estimates that
level from the first returns of the session's pings so far, so that a replay gives the same
estimates.
"""

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.core_args import arc_params, core_motion, rule_params
from mapperd.mapping.ping_log import ArcPing, PingLog
from oculus_driver.noise import noise_by_range

__all__ = ["ArcIntegrator", "SurfaceLevel", "SurfaceLevelState"]

Floats = NDArray[np.float64]

STEPS = 41
"""Of levels."""


class SurfaceLevelState(NamedTuple):
    """State of a `SurfaceLevel`.

    Attributes:
        counts: (41,) int64, first returns of all pings by level.
        recent: (K, 3) uint8, first returns of the last pings: age in pings, sector, level.
    """

    counts: NDArray[np.int64]
    recent: NDArray[np.uint8]


class SurfaceLevel:
    """Level of a surface on the beam's axis, from the first returns of the pings so far.

    A quantile of the loudest samples of the first returns: quieter ones lie off the axis, and much
    louder ones, which face the sonar, are left to the model's broad share. Material and grazing
    angle change along a dive and over a fan. So the first returns of the last pings refine the
    estimate by bearing, the more of them the more.

    Args:
        edge_m: of a voxel; levels are pooled over voxels as the rule does.
    """

    QUANTILE = 0.75
    FACTOR = 1.3
    LOUDEST = STEPS - 1
    """Louder first returns do not count."""
    DEFAULT, LEAST, LEAST_OF_SECTOR = 30.0, 12.0, 6.0
    RETURN_M = 0.5
    """Depth of a first return."""
    NEAREST_M = 0.6
    NOISE_FACTOR, MIN_RETURN = 5.0, 8.0
    PINGS, SECTORS = 8, 16
    """Number of the last pings, and of the parts of their fans."""
    ENOUGH = 30
    """Number of first returns of a sector that count as much as all pings."""

    def __init__(self, edge_m: float) -> None:
        self._edge_m = edge_m
        self._counts = np.zeros(STEPS, dtype=np.int64)
        self._recent = np.zeros((0, 3), dtype=np.uint8)

    @property
    def returns(self) -> int:
        """Number of first returns that the estimate rests on."""
        return int(self._counts.sum())

    @property
    def level(self) -> float:
        """The estimate over all pings; a default before the first return."""
        if self.returns == 0:
            return self.DEFAULT
        return max(self.LEAST, float(self._level_of(self._counts)))

    def by_beam(self, beams: int) -> NDArray[np.float32]:
        """Return the estimates for the beams of a ping, (beams,)."""
        _, sector, level = self._recent.T.astype(np.intp)
        alone = np.bincount(sector * STEPS + level, minlength=self.SECTORS * STEPS)
        wide = np.pad(alone.reshape(self.SECTORS, STEPS), ((1, 1), (0, 0)))
        counts = wide[:-2] + wide[1:-1] + wide[2:]
        number = counts.sum(axis=1)
        near = np.maximum(self.LEAST_OF_SECTOR, self._level_of(counts))
        weight = number / (number + self.ENOUGH)
        logarithms = weight * np.log(near) + (1 - weight) * np.log(self.level)
        middles = (np.arange(self.SECTORS) + 0.5) / self.SECTORS
        found = np.interp((np.arange(beams) + 0.5) / beams, middles, logarithms)
        levels: NDArray[np.float32] = np.exp(found).astype(np.float32)
        return levels

    def add(self, image: PingImage, noise: NDArray[np.float32]) -> None:
        """Add the first returns of a ping; `noise` is the level of its noise, (rows,)."""
        self._recent = self._recent[self._recent[:, 0] < self.PINGS - 1]
        self._recent[:, 0] += 1
        depth = max(1, round(self._edge_m / image.range_resolution_m))
        rows, groups = image.intensity.shape[0] // depth, image.intensity.shape[1] // 4
        whole = image.intensity[: rows * depth, : groups * 4]
        pairs = np.maximum(whole[:, ::2], whole[:, 1::2])
        loudest = np.maximum(pairs[:, ::2], pairs[:, 1::2])
        near = round(self.NEAREST_M / self._edge_m)
        levels = loudest.reshape(rows, depth, groups).max(axis=1)[near:]
        if levels.size == 0:
            return
        loudest_noise = noise[: rows * depth].reshape(rows, depth).max(axis=1)[near:, None]
        heard = levels >= np.maximum(self.NOISE_FACTOR * loudest_noise, self.MIN_RETURN)
        first = heard.argmax(axis=0)
        group = np.flatnonzero(heard.any(axis=0))
        reach = round(self.RETURN_M / self._edge_m)
        row = np.minimum(first[group] + np.arange(reach)[:, None], len(levels) - 1)
        level_of_return = levels[row, group].max(axis=0, initial=0.0)
        kept = level_of_return <= self.LOUDEST
        group, level = group[kept], level_of_return[kept].astype(np.uint8)
        np.add.at(self._counts, level, 1)
        sector = (group * self.SECTORS // groups).astype(np.uint8)
        found = np.stack([np.zeros_like(sector), sector, level], axis=1)
        self._recent = np.concatenate([self._recent, found])

    def _level_of(self, counts: NDArray[np.int64]) -> Floats:
        """Return the level by histograms of first returns, (..., STEPS); 0 without any."""
        rising = np.cumsum(counts, axis=-1)
        middle = (rising < self.QUANTILE * rising[..., -1:]).sum(axis=-1)
        found: Floats = self.FACTOR * middle
        return found

    def state(self) -> SurfaceLevelState:
        """Return everything that `restore` needs to continue exactly."""
        return SurfaceLevelState(self._counts.copy(), self._recent.copy())

    def restore(self, state: SurfaceLevelState) -> None:
        """Continue as the one of which `state` was taken, of voxels of the same edge.

        Raises:
            ValueError: it is of no estimate.
        """
        counts, recent = state
        if counts.shape != (STEPS,) or counts.dtype != np.int64:
            raise ValueError("a histogram of another shape or type")
        if recent.shape != (len(recent), self._recent.shape[1]) or recent.dtype != np.uint8:
            raise ValueError("first returns of another shape or type")
        if (recent >= (self.PINGS, self.SECTORS, STEPS)).any():
            raise ValueError("first returns of an unknown ping, sector or level")
        self._counts, self._recent = counts.copy(), recent.copy()


class ArcIntegrator:
    """Integrates pings into a map by the arc rule.

    Args:
        config: the settings.

    Raises:
        ConfigError: the core refuses them.

    Attributes:
        surface: estimate of the session.
        log: receives the integrated pings, for `refine`; None keeps none.
    """

    def __init__(self, config: Config) -> None:
        self.log: PingLog | None = None
        self._config = config
        self._model = _core.ArcModel(arc_params(config), rule_params(config))
        self.surface = SurfaceLevel(config.octree.voxel_resolution)
        self._noise = np.ones(0, dtype=np.float32)

    def reconfigure(self, config: Config) -> None:
        """Use other settings; the estimate stays."""
        if config.arc != self._config.arc:
            self._model = _core.ArcModel(arc_params(config), rule_params(config))
        self._config = config

    @property
    def level(self) -> float:
        """Level of a surface on the axis, over all pings so far."""
        return self._config.arc.level or self.surface.level

    def add_returns(self, image: PingImage) -> None:
        """Measure the noise of a ping, and add its first returns to the estimate."""
        self._noise = _noise_of(image)
        self.surface.add(image, self._noise)

    def integrate(
        self,
        core: _core.VoxelMap,
        image: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None,
    ) -> _core.PingStats:
        """Integrate the ping whose returns were added last.

        Raises:
            ValueError, IndexError: the core refuses it; the map is unchanged.
            ExportError: the log cannot be written.
        """
        settings = self._config.mapping
        level = self.surface.by_beam(image.intensity.shape[1])
        if self._config.arc.level:
            level[:] = self._config.arc.level
        ping = ArcPing(
            image.intensity,
            level,
            self._noise,
            image.bearings_rad,
            image.range_resolution_m,
            map_T_sonar,
            motion if settings.within_ping_motion else None,
            self._config.filtering.min_range,
            settings.carve_no_return,
            self._model,
        )
        changes = None if self.log is None else _core.ArcChanges()
        stats = core.integrate_arc(*_data_of(ping), **self._options_of(ping), changes=changes)
        if self.log is not None and changes is not None:
            self.log.add(ping, changes)
        return stats

    def refine(self, core: _core.VoxelMap) -> Iterator[None]:
        """Integrate the pings of the log again, the last one first, and close the log.

        Yields after each ping.

        Raises:
            ExportError: the log cannot be read.
        """
        if self.log is None:
            return
        with contextlib.closing(self.log) as log:
            self.log = None
            for ping, changes in log.from_last():
                core.refine_arc(*_data_of(ping), **self._options_of(ping), changes=changes)
                yield

    def _options_of(self, ping: ArcPing) -> dict[str, Any]:
        return {
            "min_range_m": ping.min_range_m,
            "carve_no_return": ping.carve_no_return,
            "threads": self._config.mapping.threads,
            "motion": core_motion(ping.motion),
        }


def _data_of(ping: ArcPing) -> tuple[Any, ...]:
    """Return the positional arguments of the core."""
    return (
        ping.model,
        ping.intensity / ping.level,
        ping.noise / ping.level.mean(),
        ping.bearings_rad,
        ping.range_resolution_m,
        ping.map_T_sonar,
    )


NOISE_SHARE = 0.35
"""Noise of the model over `noise_by_range`: distant floors fill whole bands, and count as noise."""


def _noise_of(image: PingImage) -> NDArray[np.float32]:
    """Return the level of the noise by row, (rows,); at least one step of an 8-bit image."""
    noise = np.float32(NOISE_SHARE) * noise_by_range(image.intensity)
    found: NDArray[np.float32] = np.maximum(np.float32(1.0), noise)
    return found
