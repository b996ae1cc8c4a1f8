"""The arc rule: maps in which the level of an echo tells where on its arc it comes from.

The core integrates levels relative to that of a surface on the beam's axis
(`cpp/map/include/mapperd/map/arc_integrator.hpp` has the definition). `SurfaceLevel` estimates that
level from the first returns of the session's pings so far, so that a replay gives the same
estimates.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.geometry.motion import PingMotion
from mapperd.imaging.ping_image import PingImage
from mapperd.mapping.core_args import arc_params, core_motion, rule_params

__all__ = ["ArcIntegrator", "SurfaceLevel", "SurfaceLevelState"]

Floats = NDArray[np.float64]

STEPS = 256


class SurfaceLevelState(NamedTuple):
    """State of a `SurfaceLevel`.

    Attributes:
        counts: (256,) int64, first returns by level.
    """

    counts: NDArray[np.int64]


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
    def returns(self) -> int:
        """Number of first returns that the estimate rests on."""
        return int(self._counts.sum())

    @property
    def level(self) -> float:
        """The estimate; a default before the first return."""
        total = self.returns
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
        if levels.size == 0:
            return
        heard = levels >= max(self.NOISE_FACTOR * noise, self.MIN_RETURN)
        first = heard.argmax(axis=0)
        beam = np.flatnonzero(heard.any(axis=0))
        reach = round(self.RETURN_M / self._edge_m)
        row = np.minimum(first[beam] + np.arange(reach)[:, None], len(levels) - 1)
        loudest = levels[row, beam].max(axis=0, initial=0.0)
        np.add.at(self._counts, loudest[loudest <= self.LOUDEST].astype(np.int64), 1)

    def state(self) -> SurfaceLevelState:
        """Return everything that `restore` needs to continue exactly."""
        return SurfaceLevelState(self._counts.copy())

    def restore(self, state: SurfaceLevelState) -> None:
        """Continue as the one of which `state` was taken, of voxels of the same edge.

        Raises:
            ValueError: it is of no estimate.
        """
        if state.counts.shape != (STEPS,) or state.counts.dtype != np.int64:
            raise ValueError("a histogram of another shape or type")
        self._counts = state.counts.copy()


class ArcIntegrator:
    """Integrates pings into a map by the arc rule.

    Args:
        config: the settings.

    Raises:
        ConfigError: the core refuses them.

    Attributes:
        surface: estimate of the session.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._model = _core.ArcModel(arc_params(config), rule_params(config))
        self.surface = SurfaceLevel(config.octree.voxel_resolution)

    def reconfigure(self, config: Config) -> None:
        """Use other settings; the estimate stays."""
        if config.arc != self._config.arc:
            self._model = _core.ArcModel(arc_params(config), rule_params(config))
        self._config = config

    @property
    def level(self) -> float:
        """Level of a surface on the axis that the next ping takes."""
        return self._config.arc.level or self.surface.level

    def add_returns(self, image: PingImage) -> None:
        """Add the first returns of a ping to the estimate."""
        self.surface.add(image, _noise_of(image))

    def integrate(
        self,
        core: _core.VoxelMap,
        image: PingImage,
        map_T_sonar: Floats,  # noqa: N803 frames are named
        motion: PingMotion | None,
    ) -> _core.PingStats:
        """Integrate a ping whose returns were added.

        Raises:
            ValueError, IndexError: the core refuses it; the map is unchanged.
        """
        settings, level = self._config.mapping, np.float32(self.level)
        return core.integrate_arc(
            self._model,
            image.intensity / level,
            np.full(len(image.intensity), _noise_of(image) / level, dtype=np.float32),
            image.bearings_rad,
            image.range_resolution_m,
            map_T_sonar,
            min_range_m=self._config.filtering.min_range,
            carve_no_return=settings.carve_no_return,
            threads=settings.threads,
            motion=core_motion(motion if settings.within_ping_motion else None),
        )


def _noise_of(image: PingImage) -> float:
    """Return the median level of the noise."""
    return max(1.0, float(np.quantile(image.intensity[::4, ::4], 0.25)))
