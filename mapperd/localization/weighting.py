"""Weights of particles: how well a scan fits the map.

Positions that a return may have: a ping measures range and bearing, but no elevation.

A line array measures the component of a direction along itself. All directions of a bearing b
therefore lie on a cone; at elevation e the direction is (sqrt(1 - sin(b)^2 - sin(e)^2), -sin(b),
sin(e)). Off the fan's plane and off its middle this differs from the vertical plane of the bearing:
by 1.6 deg at a bearing of 60 deg and an elevation of 10 deg.
"""

import math
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapperd.config.tree import Config
from mapperd.localization.hypothesis import hit_share
from mapperd.localization.maps import GridMap, LocalizationMap, VolumeMap
from mapperd.localization.models import beam_model, core_grid, field_of, filter_params, hit_model
from mapperd.localization.particle_filter import (
    Beams,
    Endpoints,
    FreeSpace,
    LikelihoodField,
    ParticleFilter,
    RangeMap,
    Weighed,
)
from mapperd.localization.scan import Scan, decimated, heard_aperture_rad

__all__ = ["MapWeighing", "elevation_fan_rad", "ends_on_cones", "threads_of"]

Floats = NDArray[np.float64]


def elevation_fan_rad(count: int, vertical_aperture_rad: float) -> Floats:
    """Return (count,) elevations: the middles of equal parts of the aperture."""
    return ((np.arange(count) + 0.5) / count - 0.5) * vertical_aperture_rad


def ends_on_cones(scan: Scan, elevation_rad: Floats, base_height_m: float) -> Floats:
    """Return the beam's ends (N, E, 3) for each return and elevation.

    Args:
        scan: the returns.
        elevation_rad: (E,) above the fan's plane, sonar frame.
        base_height_m: height of the base in the map.

    Returns:
        x ahead and y to port in the level frame, and the height in the map frame; metres.
    """
    sine, up = np.sin(scan.bearing_rad)[:, None], np.sin(elevation_rad)[None, :]
    # Near the array's axis no direction has this elevation: use the edge of the cone.
    edge = np.abs(np.cos(scan.bearing_rad))[:, None]
    up = np.clip(up, -edge, edge)
    ahead = np.sqrt(np.maximum(1.0 - sine**2 - up**2, 0.0))
    directions = np.stack([ahead, np.broadcast_to(-sine, ahead.shape), up], axis=-1)
    turn, place = scan.level_T_sonar[:3, :3], scan.level_T_sonar[:3, 3]
    ends: Floats = scan.range_m[:, None, None] * (directions @ turn.T) + place
    ends[..., 2] += base_height_m
    return ends


SEARCH_BEAMS, SEARCH_ELEVATIONS = 30, 3
"""Enough for a coarse search; all beams refine the pose."""

MIN_BEAMS = 15
"""Minimum number of beams of a scan for a search, unless the settings thin scans more."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fields:
    """Fields computed from a map, which takes long.

    Attributes:
        free: free space for the vehicle; None if there is none.
        against: field that scans are compared with.
        broad: blurred field for searches; None without searches.
    """

    free: FreeSpace | None
    against: LikelihoodField | RangeMap
    broad: LikelihoodField | None


class MapWeighing:
    """A map prepared for weighing particles; immutable.

    Args:
        known: the map.
        config: the settings.
        fields: fields of the map, if already computed.

    Attributes:
        free: free space for the vehicle; None if there is none.
        is_product: the model multiplies over beams.
    """

    def __init__(
        self, known: LocalizationMap, config: Config, fields: "_Fields | None" = None
    ) -> None:
        self._known, self._config = known, config
        self._fields = fields or _fields_of(known, config)
        self._against, self._broad = self._fields.against, self._fields.broad
        self.free = self._fields.free
        self.is_product = config.amcl.laser_model_type == "likelihood_field_prob"

    def with_settings(self, config: Config) -> "MapWeighing":
        """Return the map with other settings; fields are rebuilt only if affected."""
        same = _shaping(config) == _shaping(self._config)
        return MapWeighing(self._known, config, self._fields if same else None)

    def can_search(self, scan: Scan) -> bool:
        """Whether a cloud can be drawn from the scan."""
        least = min(MIN_BEAMS, self._config.amcl.max_beams)
        return self.searches and len(scan) >= least

    @property
    def searches(self) -> bool:
        """Whether the settings allow drawing clouds from scans."""
        return self._broad is not None

    def draw(self, particles: ParticleFilter, scan: Scan, base_height_m: float) -> None:
        """Draw a new cloud from a scan; `can_search` holds for it."""
        ours, amcl = self._config.localization, self._config.amcl
        if self._broad is None or self.free is None:
            raise ValueError("the settings ask for no search, or the map has no free cell")
        few = decimated(scan, SEARCH_BEAMS)
        ends = self._ends(few, base_height_m, min(SEARCH_ELEVATIONS, ours.elevations))
        # The thinned beams carry the weight of all.
        kappa = min(ours.tempering * len(scan) / len(few), 1.0)
        poses = max(ours.search_poses, amcl.max_particles)
        particles.start_by_scan(self.free, self._broad, ends, poses, kappa)

    def drawn(self, scan: Scan, base_height_m: float, seed: int) -> Floats:
        """Return poses (N, 3) of a new cloud from a scan; `can_search` holds for it."""
        cloud = ParticleFilter(filter_params(self._config), seed, threads_of(self._config))
        self.draw(cloud, scan, base_height_m)
        return cloud.poses

    @property
    def sigma_m(self) -> float:
        """Standard deviation of a hit."""
        return self._config.amcl.laser_sigma_hit

    def log_likelihoods(
        self,
        poses: Floats,
        scan: Scan,
        base_height_m: float,
        *,
        beams: int,
        elevations: int,
        broad: bool = False,
    ) -> Floats:
        """Return (N,) tempered log-likelihoods of a scan at poses (N, 3); 0 without information.

        Args:
            poses: x, y, yaw, map frame.
            scan: the scan.
            base_height_m: height of the base in the map.
            beams: number that the scan is thinned to; they carry the weight of all.
            elevations: number per return, on a map with heights.
            broad: use the blurred map.
        """
        field = self._broad if broad else self._against
        if not isinstance(field, LikelihoodField) or not len(scan):
            return np.zeros(len(poses))
        few = decimated(scan, beams)
        rule = filter_params(self._config, plain=True)
        cloud = ParticleFilter(rule, 0, threads_of(self._config))
        cloud.start_with(poses)
        kappa = min(self._config.localization.tempering * len(scan) / len(few), 1.0)
        weighed = cloud.weigh_field(
            field, self._ends(few, base_height_m, elevations), "product", kappa
        )
        if not weighed.informative:
            return np.zeros(len(poses))
        logs: Floats = cloud.log_weights + weighed.log_evidence + math.log(len(poses))
        return logs

    def weigh(
        self, particles: ParticleFilter, scan: Scan, base_height_m: float, tempering: float
    ) -> Weighed:
        """Weigh particles by a scan; tempering applies to product models."""
        how = ("product", tempering) if self.is_product else ("cube_sum", 1.0)
        if isinstance(self._against, RangeMap):
            model = beam_model(self._config.amcl)
            return particles.weigh_beams(self._against, _beams(scan), model, *how)
        ends = self._ends(scan, base_height_m, self._config.localization.elevations)
        return particles.weigh_field(self._against, ends, *how)

    def hit_share(self, weighed: Weighed) -> float | None:
        """Return the share of beams that hit the map; None if the model or the scan gives none."""
        if not (self.is_product and weighed.informative):
            return None
        amcl = self._config.amcl
        return hit_share(weighed.fit, hit_model(amcl), amcl.laser_likelihood_max_dist)

    def _ends(self, scan: Scan, base_height_m: float, elevations: int) -> Endpoints:
        if not isinstance(self._known, VolumeMap):
            return Endpoints(scan.points_m[:, None, :2].copy(), scan.quality)
        fan = elevation_fan_rad(elevations, heard_aperture_rad(self._config.sonar))
        return Endpoints(ends_on_cones(scan, fan, base_height_m), scan.quality)


def threads_of(config: Config) -> int:
    """Return the number of threads for the execution policy."""
    return (os.cpu_count() or 1) if config.amcl.execution_policy == "par" else 1


def _shaping(config: Config) -> tuple[object, ...]:
    """Return the settings that fields depend on."""
    amcl, ours = config.amcl, config.localization
    laser = [getattr(amcl, name) for name in amcl.__struct_fields__ if name.startswith("laser_")]
    return (*laser, ours.boundaries_only, ours.search_poses > 0, ours.search_sigma)


def _fields_of(known: LocalizationMap, config: Config) -> _Fields:
    grid = known.grid if isinstance(known, VolumeMap) else known
    ours = config.localization
    free = FreeSpace(core_grid(grid)) if known.has_free_cells else None
    searching = ours.search_poses > 0 and free is not None
    broad = field_of(known, config, ours.search_sigma) if searching else None
    return _Fields(free, _against(known, grid, config), broad)


def _against(known: LocalizationMap, grid: GridMap, config: Config) -> LikelihoodField | RangeMap:
    if config.amcl.laser_model_type == "beam":
        return RangeMap(core_grid(grid), threads=threads_of(config))
    return field_of(known, config)


def _beams(scan: Scan) -> Beams:
    """Return positions relative to the sonar, in the plane."""
    sensor = scan.level_T_sonar[:2, 3]
    offset = scan.points_m[:, :2] - sensor
    return Beams(
        bearing_rad=np.arctan2(offset[:, 1], offset[:, 0]),
        range_m=np.hypot(offset[:, 0], offset[:, 1]),
        quality=np.array(scan.quality),
        sensor_x_m=float(sensor[0]),
        sensor_y_m=float(sensor[1]),
    )
