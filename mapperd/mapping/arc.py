"""The arc rule: maps in which the level of an echo tells where on its arc it comes from.

Experimental: for programs and studies; the daemon maps by IWLO. The core integrates levels relative
to that of a surface on the beam's axis (`cpp/map/include/mapperd/map/arc_integrator.hpp` has the
definition). `SurfaceLevel` estimates that level from the first returns of the pings so far, so
that a replay gives the same estimates.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.imaging.ping_image import PingImage

__all__ = ["ArcConfig", "ArcMap", "SurfaceLevel"]

Floats = NDArray[np.float64]

STEPS = 256


@dataclass(frozen=True, slots=True)
class ArcConfig:
    """Settings of an `ArcMap`; levels are those of 8-bit images.

    Attributes:
        prior: log-odds of an unobserved voxel.
        occupied: evidence (log-odds less the prior) above which a voxel is occupied.
        lowest, highest: log-odds at which voxels stop.
        protected: part of a downward step that a voxel surely occupied takes.
        carve_no_return: beams without a first return are free to their end.
        level: of a surface on the axis; None estimates it.
        params: those of `_core.ArcParams` that differ from its defaults.
    """

    prior: float = -2.944
    occupied: float = 1.35
    lowest: float = -6.0
    highest: float = 6.0
    protected: float = 0.3
    carve_no_return: bool = False
    level: float | None = None
    params: tuple[tuple[str, float], ...] = ()


class SurfaceLevel:
    """Level of a surface on the beam's axis, from the first returns of all pings so far.

    A quantile of the loudest samples of the first returns: quieter ones lie off the axis, louder
    ones than `LOUDEST` face the sonar and are left to the model's broad share.

    Args:
        edge_m: of a voxel; levels are pooled over voxels as the rule does.
    """

    QUANTILE = 0.75
    FACTOR = 1.3
    LOUDEST = 60.0
    DEFAULT, LEAST = 30.0, 12.0
    RETURN_M = 0.5
    """Depth of a first return."""
    NEAREST_M = 0.6
    NOISE_FACTOR, MIN_RETURN = 5.0, 8.0

    def __init__(self, edge_m: float) -> None:
        self._edge_m = edge_m
        self._counts = np.zeros(STEPS, dtype=np.int64)

    @property
    def level(self) -> float:
        """The estimate; a default before the first return."""
        total = int(self._counts.sum())
        if total == 0:
            return self.DEFAULT
        middle = int(np.searchsorted(np.cumsum(self._counts), self.QUANTILE * total))
        return max(self.LEAST, self.FACTOR * middle)

    def add(self, image: PingImage, noise: float) -> None:
        """Add the first returns of a ping; `noise` is the median level of its noise."""
        depth = max(1, round(self._edge_m / image.range_resolution_m))
        rows, beams = image.intensity.shape[0] // depth, image.intensity.shape[1] // 4
        pooled = image.intensity[: rows * depth, : beams * 4].reshape(rows, depth, beams, 4)
        levels = pooled.max(axis=(1, 3))[round(self.NEAREST_M / self._edge_m) :]
        heard = levels >= max(self.NOISE_FACTOR * noise, self.MIN_RETURN)
        first = heard.argmax(axis=0)
        beam = np.flatnonzero(heard.any(axis=0))
        reach = round(self.RETURN_M / self._edge_m)
        row = np.minimum(first[beam] + np.arange(reach)[:, None], len(levels) - 1)
        loudest = levels[row, beam].max(axis=0, initial=0.0)
        np.add.at(self._counts, loudest[loudest <= self.LOUDEST].astype(np.int64), 1)


@dataclass(frozen=True, slots=True)
class _Occupied:
    """Centres (N, 3) of the occupied voxels."""

    centres_m: Floats


class ArcMap:
    """A map that the arc rule makes, with the reading side of `SonarMap`.

    Args:
        edge_m: of a voxel.
        config: the rule's settings.
    """

    def __init__(self, edge_m: float, config: ArcConfig) -> None:
        self.config = config
        params = _core.ArcParams(**dict(config.params))
        rule = _core.IwloParams(
            L_free=-params.free_step,
            L_min=config.lowest - config.prior,
            L_max=config.highest - config.prior,
            decay_rate=1e-5,
            min_alpha=0.999,
            adaptive_max_ratio=config.protected,
            adaptive_min_ratio=0.0,
            prior=config.prior,
        )
        self.core = _core.VoxelMap(edge_m, rule)
        self.surface = SurfaceLevel(edge_m)
        self._model = _core.ArcModel(params, rule)

    def integrate(self, image: PingImage, map_T_sonar: Floats) -> _core.PingStats:  # noqa: N803 frames are named
        """Add a ping of 8-bit levels at a pose (4, 4)."""
        noise = max(1.0, float(np.quantile(image.intensity[::4, ::4], 0.25)))
        self.surface.add(image, noise)
        level = np.float32(self.surface.level if self.config.level is None else self.config.level)
        return self.core.integrate_arc(
            self._model,
            image.intensity / level,
            np.full(len(image.intensity), noise / level, dtype=np.float32),
            image.bearings_rad,
            image.range_resolution_m,
            map_T_sonar,
            carve_no_return=self.config.carve_no_return,
        )

    def occupied(self) -> _Occupied:
        """Voxels above the threshold of the settings."""
        threshold = self.config.prior + self.config.occupied
        return _Occupied(self.core.voxels(min_log_odds=threshold)[0])
