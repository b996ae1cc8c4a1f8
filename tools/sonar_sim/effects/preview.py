"""Input of the rules before a ping is computed: settings, poses, and a coarse cast with levels."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sonar_sim.effects.coarse_picture import (
    MAX_ROWS,
    CoarseGrid,
    Gains,
    change_db,
    cloud_filling,
    equivalent_beams,
    transmitted_power,
)
from sonar_sim.effects.echoes import COLUMNS, NO_SURFACE, CoarseFan, Echoes
from sonar_sim.effects.image_difference import Tolerance
from sonar_sim.effects.planes import MirrorPlane
from sonar_sim.geometry.matmul import chunked_matmul
from sonar_sim.geometry.pose import FramePose, SonarMotion
from sonar_sim.propagation.beam_pattern import vertical_two_way_power
from sonar_sim.propagation.clouds import box_crossing
from sonar_sim.propagation.physics import Cloud, Reverberation
from sonar_sim.raycast.fan import ALL_ELEVATIONS_RAD
from sonar_sim.raycast.meshes import Meshes
from sonar_sim.receiver.gain import FULL_SCALE_DB, GAIN_DB_PER_PERCENT, noise_level_db
from sonar_sim.receiver.noise import diffuse_limit_m2, tail_power
from sonar_sim.scene.scene import Bubbles, CloudSpec, Scene, Sediment
from sonar_sim.scene.sonar import SonarSettings
from sonar_sim.scene.suspended_matter import (
    Matter,
    cloud_matter,
    sediment_db_per_m,
    sediment_strength,
)

MIN_RANGE_M = 0.05
FINE_ROWS = 512
"""Most rows of the fine picture."""


@dataclass(frozen=True, slots=True)
class VisibleCloud:
    """A cloud and what it does at the sonar's frequency."""

    spec: CloudSpec
    matter: Matter

    @property
    def box(self) -> Cloud:
        """The box as the engine takes it."""
        return Cloud(
            np.array(self.spec.low_m, dtype=np.float64),
            np.array(self.spec.high_m, dtype=np.float64),
            self.matter.db_per_m,
            10.0 * math.log10(max(self.matter.strength, 1e-30)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class SolidObjects:
    """All surfaces but the floor.

    Attributes:
        vertices_m: of surfaces of small faces, map frame, (V, 3).
        half_edge_m: half of the longest edge between these.
        large_m: lowest and highest corner of each of the others, map frame, (L, 2, 3).
        moving: whether any surface moves.
    """

    vertices_m: NDArray[np.float64]
    half_edge_m: float
    large_m: NDArray[np.float64]
    moving: bool


@dataclass(frozen=True, slots=True)
class PoseSlack:
    """How far a ping's pose may be from that of its preview.

    Attributes:
        move_m: distance.
        turn_rad: angle.
    """

    move_m: float = 0.0
    turn_rad: float = 0.0

    def angle_rad(self, range_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """By how much the direction to something at a range may differ."""
        shift: NDArray[np.float64] = np.arcsin(np.minimum(self.move_m / np.asarray(range_m), 1.0))
        return shift + self.turn_rad

    def outside(
        self,
        sines: NDArray[np.float64],
        range_m: NDArray[np.float64] | float,
        limits_rad: tuple[float, float],
    ) -> NDArray[np.bool_]:
        """Whether sines of elevation may lie outside of a lower and an upper limit."""
        elevation, slack_rad = np.arcsin(sines), self.angle_rad(range_m)
        low_rad, high_rad = ALL_ELEVATIONS_RAD
        outside: NDArray[np.bool_] = np.maximum(elevation - slack_rad, low_rad) < limits_rad[0]
        return outside | (np.minimum(elevation + slack_rad, high_rad) > limits_rad[1])


@dataclass(frozen=True, slots=True, eq=False)
class PingInstance:
    """Pose, time and motion of one ping that shares a preview with others."""

    map_T_sonar: FramePose  # noqa: N815 frames in the name
    ping_id: int
    time_s: float
    motion: SonarMotion | None


@dataclass(frozen=True, eq=False)
class PingPreview:
    """One ping before it is computed. Its levels contain every effect of level.

    Attributes:
        scene, sonar: as the simulator's.
        map_T_sonar: at the transmission.
        motion: while the sonar listens.
        time_s, ping_id: of the ping.
        meshes: the scene, ready to be cast.
        planes: that could mirror.
        bottoms: names of the surfaces that are the floor.
        solids: all surfaces but the floor.
        fan: the coarse rays.
        end_m: where each met something, infinite for nothing, (N,).
        echoes: what they met in range, points included.
        cast_hidden: casts once more, from behind the first hits.
        max_rows: of the coarse picture.
        ping: if it was looked from near the ping's own pose and time; None: from there.
    """

    scene: Scene
    sonar: SonarSettings
    map_T_sonar: FramePose  # noqa: N815 frames in the name
    motion: SonarMotion | None
    time_s: float
    ping_id: int
    meshes: Meshes
    planes: tuple[MirrorPlane, ...]
    bottoms: frozenset[str]
    solids: SolidObjects
    fan: CoarseFan
    end_m: NDArray[np.float64]
    echoes: Echoes
    cast_hidden: Callable[[], Echoes]
    max_rows: int = MAX_ROWS
    ping: "PingInstance | None" = None

    def for_ping(self, ping: "PingInstance") -> "PingPreview":
        """The same, for a ping of its own motion; what is already worked out is kept."""
        own = copy.copy(self)
        vars(own).update(ping=ping, motion=ping.motion, ping_id=ping.ping_id)
        return own

    @property
    def own_pose(self) -> FramePose:
        """Pose of the ping itself."""
        return self.map_T_sonar if self.ping is None else self.ping.map_T_sonar

    @property
    def own_time_s(self) -> float:
        """Time of the ping itself."""
        return self.time_s if self.ping is None else self.ping.time_s

    @cached_property
    def hidden(self) -> Echoes:
        """What lies behind the first hits."""
        return self.cast_hidden()

    @cached_property
    def fine(self) -> "PingPreview":
        """The same with a coarse picture of the sonar's own rows, or the most that are worth it."""
        return replace(self, max_rows=FINE_ROWS)

    @cached_property
    def grid(self) -> CoarseGrid:
        """The coarse picture's rows and columns."""
        return CoarseGrid(self.sonar, self.max_rows)

    @property
    def speed_of_sound_mps(self) -> float:
        """True speed of sound."""
        return self.scene.water.speed_of_sound_mps

    @cached_property
    def water_db_per_m(self) -> float:
        """One-way absorption of the water itself."""
        return self.scene.water.absorption_db_per_m(self.sonar.frequency_hz)

    @cached_property
    def sediment_db_per_m(self) -> float:
        """One-way attenuation by what is suspended everywhere."""
        water = self.scene.water
        if water.sediment_kg_per_m3 <= 0.0:
            return 0.0
        return sediment_db_per_m(
            self.sonar.frequency_hz,
            water.sediment_kg_per_m3,
            water.sediment_radius_m,
            self.speed_of_sound_mps,
        )

    @cached_property
    def far_m(self) -> float:
        """Farthest echo, 0 without one."""
        return float(self.echoes.range_m.max(initial=0.0))

    @cached_property
    def source_power(self) -> float:
        """Power of the transmission, at 1 m."""
        return float(10.0 ** (self.sonar.source_level_db / 10.0))

    @cached_property
    def pattern(self) -> NDArray[np.float64]:
        """Two-way vertical pattern of each echo, (N,)."""
        return vertical_two_way_power(self.echoes.up, self.sonar.vertical_width_rad)

    @cached_property
    def power_per_m2(self) -> NDArray[np.float64]:
        """Received power of each echo over its cross section, (N,)."""
        return self.on_axis_power_per_m2(self.echoes) * self.pattern

    def on_axis_power_per_m2(self, echoes: Echoes) -> NDArray[np.float64]:
        """Received power per m² on the fan's plane: after spreading, absorption, clouds, (N,)."""
        range_m = np.maximum(echoes.range_m, MIN_RANGE_M)
        loss_db = 2.0 * (self.water_db_per_m + self.sediment_db_per_m) * range_m
        loss_db += self.two_way_cloud_db(self.clouds, echoes)
        power: NDArray[np.float64] = self.source_power * transmitted_power(loss_db) / range_m**4
        return power

    @cached_property
    def clouds(self) -> tuple[VisibleCloud, ...]:
        """The scene's clouds and what they do at this frequency."""
        return tuple(
            VisibleCloud(spec, cloud_matter(spec, self.sonar, self.speed_of_sound_mps))
            for spec in self.scene.clouds
        )

    def two_way_cloud_db(
        self, clouds: tuple[VisibleCloud, ...], echoes: Echoes
    ) -> NDArray[np.float64]:
        """What clouds take on the way to each echo and back, (N,)."""
        loss_db = np.zeros(len(echoes.range_m))
        if not clouds:
            return loss_db
        ways = chunked_matmul(echoes.direction, self.map_T_sonar.rotation.T).astype(np.float32)
        for cloud in clouds:
            enter_m, leave_m = box_crossing(
                cloud.box, self.map_T_sonar.position_m, ways, echoes.range_m
            )
            loss_db += 2.0 * cloud.matter.db_per_m * (leave_m - enter_m)
        return loss_db

    def clouds_of(self, kind: type[Bubbles] | type[Sediment]) -> tuple[VisibleCloud, ...]:
        """The clouds of one kind."""
        return tuple(cloud for cloud in self.clouds if isinstance(cloud.spec.matter, kind))

    def heard_without(self, kind: type[Bubbles] | type[Sediment]) -> NDArray[np.float64]:
        """What would be heard of a pixel if the clouds of one kind were not, (rows, COLUMNS)."""
        gone = self.clouds_of(kind)
        left = tuple(cloud for cloud in self.clouds if cloud not in gone)
        power = self.echo_power / transmitted_power(self.two_way_cloud_db(gone, self.echoes))
        picture = self.grid.picture(self.echoes, power) + self.tail_picture
        return picture + self._water_picture(left)

    def _water_picture(self, clouds: tuple[VisibleCloud, ...]) -> NDArray[np.float64]:
        return self.volume_picture + self.picture_of_clouds(clouds)

    @cached_property
    def echo_power(self) -> NDArray[np.float64]:
        """Received power of each echo, (N,)."""
        return self.echoes.section_m2 * self.power_per_m2

    @cached_property
    def echo_picture(self) -> NDArray[np.float64]:
        """Expected power of a pixel by surfaces and points, (rows, COLUMNS)."""
        return self.grid.picture(self.echoes, self.echo_power)

    @cached_property
    def noise_power(self) -> float:
        """Noise power of a pixel."""
        return float(10.0 ** (noise_level_db(self.sonar, self.scene.water) / 10.0))

    @cached_property
    def beam_solid_angle_sr(self) -> float:
        """Solid angle that a beam hears, two-way vertical pattern and azimuth beam together."""
        w = np.linspace(-1.0, 1.0, 401)
        up = float(np.trapezoid(vertical_two_way_power(w, self.sonar.vertical_width_rad), w))
        return up * equivalent_beams(self.sonar) * self.sonar.sine_pitch

    @cached_property
    def open_water(self) -> NDArray[np.float64]:
        """Power that scatterers of 0 dB re 1/m in all the water would send, (rows, 1)."""
        range_m = np.maximum(self.grid.range_m, MIN_RANGE_M)
        loss_db = 2.0 * (self.water_db_per_m + self.sediment_db_per_m) * range_m
        cell_m3 = self.beam_solid_angle_sr * range_m**2 * self.sonar.range_resolution_m
        power = self.source_power * cell_m3 * transmitted_power(loss_db) / range_m**4
        column: NDArray[np.float64] = power[:, None]
        return column

    @cached_property
    def volume_strength(self) -> float:
        """Back scattering of a cubic metre of the open water, sediment included, 1/m."""
        water = self.scene.water
        grains = sediment_strength(
            self.sonar.frequency_hz,
            water.sediment_kg_per_m3,
            water.sediment_radius_m,
            self.speed_of_sound_mps,
        )
        return float(10.0 ** (water.volume_strength_db / 10.0) + grains)

    @cached_property
    def volume_picture(self) -> NDArray[np.float64]:
        """Expected power of a pixel by the water's own scatterers, (rows, COLUMNS)."""
        power = self.volume_strength * self.open_water * np.ones(COLUMNS)
        picture: NDArray[np.float64] = power
        return picture

    def picture_of_clouds(self, clouds: tuple[VisibleCloud, ...]) -> NDArray[np.float64]:
        """Expected power of a pixel by bubbles and sediment in clouds, (rows, COLUMNS)."""
        return self._clouds_by(clouds, self.fan, self.end_m)

    def _clouds_by(
        self, clouds: tuple[VisibleCloud, ...], fan: CoarseFan, end_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The same by some of the coarse rays."""
        picture = np.zeros((self.grid.rows, COLUMNS))
        for cloud in clouds:
            filled = cloud_filling(cloud.box, self.grid, fan, self.map_T_sonar, end_m)
            picture += self.open_water * cloud.matter.strength * filled
        return picture

    @cached_property
    def reverberation(self) -> Reverberation:
        """The tail that echoes leave in this water."""
        water = self.scene.water
        energy = 10.0 ** (water.reverberation_db / 10.0)
        return Reverberation(energy, water.reverberation_decay_db_per_m)

    @cached_property
    def tail_picture(self) -> NDArray[np.float64]:
        """Expected power of a pixel by the tail behind echoes, (rows, COLUMNS)."""
        echoes = self.echoes
        surfaces = np.where(echoes.surface == NO_SURFACE, 0.0, self.power_per_m2)  # points are few
        picture = self.grid.main_lobes(echoes, echoes.lambert_m2 * surfaces)
        if echoes.lobe_m2.any():
            picture += self.grid.main_lobes(echoes, echoes.lobe_m2 * surfaces)
        return self.tail_of(picture)

    def tail_of(self, picture: NDArray[np.float64]) -> NDArray[np.float64]:
        """Expected power of a pixel by the tail of what is heard, (rows, COLUMNS)."""
        heard = np.minimum(picture, self._diffuse_limit)
        return tail_power(heard, self.grid.sine, self.grid.row_m, self.reverberation)

    @property
    def _diffuse_limit(self) -> NDArray[np.float64]:
        """Power of a pixel above which an echo leaves no more tail: it is a flash, (rows, 1)."""
        range_m = np.maximum(self.grid.range_m, MIN_RANGE_M)
        loudest = float(self.meshes.strengths[:, 0].max(initial=0.0))
        limit_m2 = diffuse_limit_m2(self.sonar, loudest)
        limit_m2 = np.interp(range_m, self.sonar.row_centres_m, limit_m2)
        loss_db = 2.0 * (self.water_db_per_m + self.sediment_db_per_m) * range_m
        power = self.source_power * limit_m2 * transmitted_power(loss_db) / range_m**4
        column: NDArray[np.float64] = power[:, None]
        return column

    @cached_property
    def heard(self) -> NDArray[np.float64]:
        """Expected power of a pixel before the noise, beside which the faint is lost."""
        return self.echo_picture + self.tail_picture + self._water_picture(self.clouds)

    @cached_property
    def picture(self) -> NDArray[np.float64]:
        """Expected power of a pixel, noise included, (rows, COLUMNS)."""
        return self.heard + self.noise_power

    @cached_property
    def gains(self) -> Gains:
        """The receiver's gains; the time-varied gain compensates the water's absorption."""
        range_m = self.grid.range_m
        tvg_db = self.sonar.tvg_spreading_log * np.log10(range_m)
        tvg_db += 2.0 * self.water_db_per_m * range_m
        operator_db = GAIN_DB_PER_PERCENT * self.sonar.gain_percent
        return Gains(tvg_db, operator_db, FULL_SCALE_DB)

    @cached_property
    def amplitude(self) -> NDArray[np.float64]:
        """Amplitude as a share of full scale, (rows, COLUMNS)."""
        return self.gains.amplitude(self.picture)

    def change_db(self, power: NDArray[np.float64], tolerance: Tolerance) -> float:
        """How much the coarse picture differs from one of these powers, (rows, COLUMNS)."""
        return change_db(self.amplitude, self.gains.amplitude(power), self.sonar, tolerance)

    def change_in_place_db(self, power: NDArray[np.float64], tolerance: Tolerance) -> float:
        """The same for what changes whole rows smoothly: no displacement explains it.

        One might seem to, as neighbouring coarse cells differ by the luck of their few rays.
        """
        other = self.gains.amplitude(power)
        return change_db(self.amplitude, other, self.sonar, tolerance, displaced=False)

    def change_of_echoes_db(self, power: NDArray[np.float64], tolerance: Tolerance) -> float:
        """The same where only the echoes' powers (N,) differ; their tail is left as it is."""
        if np.array_equal(power, self.echo_power):
            return 0.0
        other = self.picture - self.echo_picture + self.grid.picture(self.echoes, power)
        return self.change_db(np.maximum(other, 0.0), tolerance)

    def change_beyond_db(
        self, limits_rad: tuple[float, float], tolerance: Tolerance, slack: PoseSlack
    ) -> float:
        """The same without what may lie below and above two elevations; its tail is left as it is.

        Args:
            limits_rad: the lower and the upper elevation.
            tolerance: by which pictures are compared.
            slack: how far the ping's pose may be from the view's.
        """
        outside = slack.outside(self.echoes.up, self.echoes.range_m, limits_rad)
        power = np.where(outside, self.echo_power, 0.0)
        other = self.picture - self.grid.picture(self.echoes, power)
        if self.clouds:
            boxes_m = np.array([(cloud.spec.low_m, cloud.spec.high_m) for cloud in self.clouds])
            sonar_m, sines = self.map_T_sonar.position_m, self.fan.directions[:, 2]
            away_m = np.clip(sonar_m, boxes_m[:, 0], boxes_m[:, 1]) - sonar_m
            nearest_m = max(float(np.linalg.norm(away_m, axis=1).min()), 1e-9)
            rays = np.flatnonzero(slack.outside(sines, nearest_m, limits_rad))
            fan = replace(
                self.fan,
                directions=self.fan.directions[rays],
                column=self.fan.column[rays],
                solid_angle_sr=self.fan.solid_angle_sr[rays],
            )
            other -= self._clouds_by(self.clouds, fan, self.end_m[rays])
        return self.change_db(np.maximum(other, 0.0), tolerance)

    def reach_rad(self, slack: PoseSlack) -> tuple[float, float]:
        """How far down and up all but the floor may reach: elevations of vertices in range.

        A right angle where surfaces move or have large faces: their vertices do not tell. The
        middle of a small face is half an edge from a vertex at most.
        """
        slack = PoseSlack(slack.move_m + self.solids.half_edge_m, slack.turn_rad)
        sonar_m, reach_m = self.map_T_sonar.position_m, self.sonar.range_m + slack.move_m
        low_m, high_m = self.solids.large_m[:, 0], self.solids.large_m[:, 1]
        gap_m = np.linalg.norm(np.clip(sonar_m, low_m, high_m) - sonar_m, axis=1)
        if self.solids.moving or np.any(gap_m < reach_m):
            return math.pi / 2.0, math.pi / 2.0
        local_m = chunked_matmul(self.solids.vertices_m - sonar_m, self.map_T_sonar.rotation)
        range_m = np.linalg.norm(local_m, axis=1)
        # A ping that leans looks over what lies a little behind.
        behind_m = slack.move_m + math.sin(slack.turn_rad) * range_m
        near = np.flatnonzero((range_m < reach_m) & (local_m[:, 0] > -behind_m))
        range_m = np.maximum(range_m[near], 1e-9)
        elevation, slack_rad = np.arcsin(local_m[near, 2] / range_m), slack.angle_rad(range_m)
        down = float((slack_rad - elevation).max(initial=0.0))
        return down, float((slack_rad + elevation).max(initial=0.0))
