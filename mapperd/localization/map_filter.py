"""The core's particle filter on a map, by the settings."""

import math
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config import Config
from mapperd.localization.beam_ends import elevation_fan_rad, ends_on_cones
from mapperd.localization.cloud_state import CloudState, cloud_state, restore_cloud
from mapperd.localization.estimate import Belief, PlanarGaussian
from mapperd.localization.filter import (
    Beams,
    Endpoints,
    FreeSpace,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
    Weighed,
    belief,
)
from mapperd.localization.grid_map import GridMap
from mapperd.localization.models import beam_model, core_grid, field_of, filter_rule
from mapperd.localization.scan import Scan
from mapperd.localization.update_gate import PlanarPose
from mapperd.localization.volume_map import LocalizationMap, VolumeMap

__all__ = ["FilterState", "MapFilter"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """All that changes in a filter, but for the map and the settings.

    Attributes:
        cloud: the particles.
        stamp_ns: of the last scan; None before the first.
    """

    cloud: CloudState
    stamp_ns: int | None


class MapFilter:
    """Particles on a map. One thread at a time.

    Args:
        config: the settings.

    Attributes:
        weighed: what the last scan did to the weights; None before one.
    """

    def __init__(self, config: Config) -> None:
        self.weighed: Weighed | None = None
        self._config = config
        seed = config.localization.random_seed
        self._particles = ParticleFilter(filter_rule(config.amcl), seed, _threads(config))
        self._known: LocalizationMap | None = None
        self._against: LikelihoodField | RangeMap | None = None
        self._free: FreeSpace | None = None
        self._stamp_ns: int | None = None

    @property
    def particles(self) -> ParticleFilter:
        """The core's filter, to look at."""
        return self._particles

    def reconfigure(self, config: Config) -> None:
        """As `PoseFilter.reconfigure`; on any error all is as before."""
        rule = filter_rule(config.amcl)
        against = self._against
        if self._known is not None and _models(config) != _models(self._config):
            against = _against(self._known, config)
        self._particles.set_rule(rule)
        self._particles.set_threads(_threads(config))
        self._config, self._against = config, against

    def take_map(self, known: LocalizationMap) -> None:
        """As `PoseFilter.take_map`; on any error all is as before."""
        against = _against(known, self._config)
        self._free = FreeSpace(core_grid(_grid(known))) if known.has_free_cells else None
        self._known, self._against = known, against

    def start_at(self, pose: PlanarGaussian) -> None:
        """As `PoseFilter.start_at`."""
        self._particles.start_about(np.array([pose.x_m, pose.y_m, pose.yaw_rad]), pose.covariance)
        self._stamp_ns = None

    def start_anywhere(self) -> None:
        """As `PoseFilter.start_anywhere`.

        Raises:
            ValueError: there is no map, or it has no free cell.
        """
        if self._free is None:
            raise ValueError("there is no free cell to start from")
        self._particles.start_anywhere(self._free)
        self._stamp_ns = None

    def state(self) -> FilterState:
        """All that changes, but for the map and the settings."""
        return FilterState(cloud_state(self._particles), self._stamp_ns)

    def restore(self, state: FilterState) -> None:
        """Go on as the filter that `state` was called of, on the same map and settings.

        Raises:
            ValueError: it is no filter's state; nothing is changed.
        """
        restore_cloud(self._particles, state.cloud)
        self._stamp_ns = state.stamp_ns

    def update(
        self, before: PlanarPose, now: PlanarPose, scan: Scan, base_height_m: float
    ) -> Belief:
        """As `PoseFilter.update`."""
        self._move(before, now, scan.stamp_ns)
        self.weighed = self._weigh(scan, base_height_m)
        found = belief(self._particles)
        self._particles.resample_if_due(self._free)
        return found

    def _move(self, before: PlanarPose, now: PlanarPose, stamp_ns: int) -> None:
        amcl, ours = self._config.amcl, self._config.localization
        passed_s = 0.0 if self._stamp_ns is None else max(stamp_ns - self._stamp_ns, 0) / 1e9
        alphas = [getattr(amcl, f"odom_alpha{k}") for k in range(1, 6)]
        self._particles.predict(
            _array(before),
            _array(now),
            amcl.robot_model_type,
            np.array(alphas, dtype=np.float64),
            ours.sigma_floor_xy * math.sqrt(passed_s),
            ours.sigma_floor_yaw * math.sqrt(passed_s),
        )
        self._stamp_ns = stamp_ns

    def _weigh(self, scan: Scan, base_height_m: float) -> Weighed:
        amcl, ours = self._config.amcl, self._config.localization
        product = amcl.laser_model_type == "likelihood_field_prob"
        how = ("product", ours.tempering) if product else ("cube_sum", 1.0)
        if isinstance(self._against, RangeMap):
            return self._particles.weigh_beams(self._against, _beams(scan), beam_model(amcl), *how)
        if self._against is None:
            raise ValueError("there is no map to weigh by")
        if isinstance(self._known, VolumeMap):
            aperture_rad = math.radians(self._config.sonar.vertical_aperture)
            fan = elevation_fan_rad(ours.elevations, aperture_rad)
            ends = Endpoints(ends_on_cones(scan, fan, base_height_m), scan.quality)
        else:
            ends = Endpoints(scan.points_m[:, None, :2].copy(), scan.quality)
        return self._particles.weigh_field(self._against, ends, *how)


def _models(config: Config) -> tuple[object, ...]:
    """The settings that fields and ranges are made by."""
    amcl = config.amcl
    named = (getattr(amcl, name) for name in amcl.__struct_fields__ if name.startswith("laser_"))
    return (*named, config.localization.boundaries_only)


def _grid(known: LocalizationMap) -> GridMap:
    return known.grid if isinstance(known, VolumeMap) else known


def _against(known: LocalizationMap, config: Config) -> LikelihoodField | RangeMap:
    if config.amcl.laser_model_type == "beam":
        return RangeMap(core_grid(_grid(known)), threads=_threads(config))
    return field_of(known, config)


def _beams(scan: Scan) -> Beams:
    """As seen from the sonar, in the plane."""
    sensor = scan.level_T_sonar[:2, 3]
    offset = scan.points_m[:, :2] - sensor
    return Beams(
        bearing_rad=np.arctan2(offset[:, 1], offset[:, 0]),
        range_m=np.hypot(offset[:, 0], offset[:, 1]),
        quality=np.array(scan.quality),
        sensor_x_m=float(sensor[0]),
        sensor_y_m=float(sensor[1]),
    )


def _threads(config: Config) -> int:
    return (os.cpu_count() or 1) if config.amcl.execution_policy == "par" else 1


def _array(pose: PlanarPose) -> Floats:
    return np.array([pose.x_m, pose.y_m, pose.yaw_rad], dtype=np.float64)
