"""All settings: one immutable tree.

Names and defaults are those of sonar_3d_reconstruction; a default that differs states why.
Every field carries one sentence, its unit, its range, and whether it may change while the
program runs. A parameter stands here only if it does something. Reading YAML is the business
of `mapperd.config.loader`.
"""

import math
from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.amcl import AmclConfig
from mapperd.config.daemon import (
    BacklogConfig,
    ChangesConfig,
    ExportConfig,
    FramesConfig,
    MavlinkConfig,
    MqttConfig,
    OutOfCoreConfig,
    RecordingConfig,
    Ros2Config,
    ServerConfig,
    ServiceConfig,
    StreamConfig,
    TopicsConfig,
    VisualizationConfig,
)
from mapperd.config.device import (
    CrosstalkConfig,
    DeviceConfig,
    RobotDetectionConfig,
    TerrainDetectionConfig,
    WaterConfig,
)
from mapperd.config.field import rule
from mapperd.config.localization import LocalizationConfig, ScanExtractionConfig
from mapperd.config.odometry import (
    OdometryFusionConfig,
    SlamQualityConfig,
    TimeSyncConfig,
    WorldInitConfig,
)

__all__ = [
    "AdaptiveConfig",
    "AmclConfig",
    "ArcConfig",
    "BacklogConfig",
    "ChangesConfig",
    "Config",
    "CrosstalkConfig",
    "DeviceConfig",
    "ExportConfig",
    "FilteringConfig",
    "FramesConfig",
    "IwloConfig",
    "LocalizationConfig",
    "MappingConfig",
    "MavlinkConfig",
    "MountingConfig",
    "MqttConfig",
    "OctreeConfig",
    "OdometryFusionConfig",
    "OrientationConfig",
    "OutOfCoreConfig",
    "PositionConfig",
    "ProcessingConfig",
    "RecordingConfig",
    "RobotDetectionConfig",
    "Ros2Config",
    "ScanExtractionConfig",
    "ServerConfig",
    "ServiceConfig",
    "SlamQualityConfig",
    "SonarConfig",
    "TerrainDetectionConfig",
    "TimeSyncConfig",
    "TopicsConfig",
    "VisualizationConfig",
    "WaterConfig",
    "WorldInitConfig",
]

MAX_COUNT = 65535  # observations that a voxel can count

MIN_TILE_VOXELS = 8
"""Edge of a block, which no tile divides."""


class SonarConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The sonar's fan."""

    horizontal_fov: Annotated[
        float,
        rule("Full horizontal angle; beams outside it are left out.", "deg", gt=0, le=180),
    ] = 130.0
    vertical_aperture: Annotated[
        float,
        rule(
            "Full vertical angle that an echo may be anywhere in. It passes the beam twice: set "
            "the data sheet's one-way width over sqrt 2, 14 for 20.",
            "deg",
            gt=0,
            le=90,
        ),
    ] = 14.0  # 20, as published, maps worse and slower: docs/reports/accuracy-cost.md, "elevation"


class FilteringConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Which samples count."""

    min_range: Annotated[
        float, rule("Samples nearer than this are ignored.", "m", live=True, ge=0, le=100)
    ] = 0.5
    intensity_threshold: Annotated[
        float,
        rule(
            "Samples above it are returns; 16 and 32 bit images are scaled to 0-255 first.",
            "0-255",
            live=True,
            ge=0,
            le=255,
        ),
    ] = 35.0
    noise_factor: Annotated[
        float,
        rule(
            "Returns must also be above so many times the noise, which is measured in each image "
            "by range; 7 suits most sonars, 0 is off. The arc rule always measures the noise.",
            live=True,
            ge=0,
            le=100,
        ),
    ] = 0.0


class PositionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the sonar sits on the vehicle (base frame)."""

    x: Annotated[float, rule("Offset forward.", "m", ge=-100, le=100)] = 0.0
    y: Annotated[float, rule("Offset to port (left).", "m", ge=-100, le=100)] = 0.0
    z: Annotated[float, rule("Offset up; negative is below.", "m", ge=-100, le=100)] = -0.5


class OrientationConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How the sonar is turned: Rz(yaw) Ry(pitch) Rx(roll)."""

    roll: Annotated[
        float, rule("Turn about the forward axis.", "deg", live=True, ge=-360, le=360)
    ] = 0.0
    pitch: Annotated[
        float,
        rule("Nose down: 0 looks forward, 90 down.", "deg", live=True, ge=-360, le=360),
    ] = 90.0
    yaw: Annotated[float, rule("Turn to port.", "deg", live=True, ge=-360, le=360)] = 0.0


class MountingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The sonar on the vehicle."""

    position: PositionConfig = PositionConfig()
    orientation: OrientationConfig = OrientationConfig()


class OctreeConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The grid."""

    voxel_resolution: Annotated[
        float,
        rule("Voxel edge; smaller shows more, costs memory and time.", "m", ge=0.001, le=100),
    ] = 0.05


UpdateRule = Annotated[
    Literal["iwlo", "arc"],
    rule(
        "iwlo: the intensity is the weight of an echo; arc: its level tells where on its arc it "
        "comes from (docs/guides/arc-rule.md)."
    ),
]


class MappingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How a ping becomes evidence, and evidence becomes classes."""

    occupied_threshold: Annotated[
        float, rule("Voxels above this probability are occupied.", live=True, gt=0, lt=1)
    ] = 0.7
    free_threshold: Annotated[
        float,
        rule(
            "Observed voxels below this probability are free, from here to "
            "occupied_threshold uncertain; at most that.",
            live=True,
            gt=0,
            lt=1,
        ),
    ] = 0.5
    aggregation: Annotated[
        Literal["occupied_first", "mean"],
        rule("Both kinds of evidence in one ping: occupied wins, or their mean.", live=True),
    ] = "occupied_first"
    carve_no_return: Annotated[
        bool, rule("Beams without a return free their whole length.", live=True)
    ] = False
    integrator: Annotated[
        Literal["evidence_grid", "rays"],
        rule(
            "evidence_grid: filter the image by the voxel's footprint, look each voxel up once; "
            "rays: sampled sub-rays.",
            live=True,
        ),
    ] = "evidence_grid"
    detail: Annotated[
        float,
        rule(
            "Fineness of the evidence grid: rows every 0.3 / detail voxels, columns every "
            "0.5 / detail voxels at most; more is more accurate and slower.",
            live=True,
            ge=0.25,
            le=8,
        ),
    ] = 1.0
    threads: Annotated[
        int,
        rule(
            "Threads of the evidence grid; the map does not depend on them.",
            live=True,
            ge=1,
            le=64,
        ),
    ] = 1
    within_ping_motion: Annotated[
        bool,
        rule(
            "Samples are placed with the pose at their own time of flight, where velocity or "
            "rate is known.",
            live=True,
        ),
    ] = True
    max_swath_voxels: Annotated[
        int,
        rule(
            "A ping whose swath holds more voxels is refused: it would take seconds and gigabytes.",
            "voxels",
            live=True,
            ge=1000,
            le=10**12,
        ),
    ] = 500_000_000
    angular_cone_width: Annotated[
        float,
        rule("Shadow tolerance of rays: factor on twice a beam's width.", live=True, ge=0, le=100),
    ] = 0.5
    rule: UpdateRule = "iwlo"  # the last field: its name hides the function

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.free_threshold > self.occupied_threshold:
            raise ValueError(
                f"free_threshold {self.free_threshold:g} is above occupied_threshold "
                f"{self.occupied_threshold:g}; allowed: at most that"
            )
        if self.integrator == "rays" and (self.carve_no_return or self.aggregation == "mean"):
            raise ValueError(
                "integrator rays knows neither carve_no_return nor aggregation mean; "
                "allowed: integrator evidence_grid with them"
            )


class IwloConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The intensity-weighted log-odds rule."""

    L_occ: Annotated[float, rule("Step of an occupied observation.", "log-odds", ge=0, le=127)] = (
        3.5
    )
    L_free: Annotated[float, rule("Step of a free observation.", "log-odds", ge=-127, le=0)] = -3.0
    L_min: Annotated[float, rule("Floor of the log-odds.", "log-odds", ge=-127, lt=0)] = -10.0
    L_max: Annotated[float, rule("Ceiling of the log-odds.", "log-odds", gt=0, le=127)] = 10.0
    sharpness: Annotated[
        float, rule("Slope from intensity to weight; higher is more yes-or-no.", ge=0, le=1000)
    ] = 3.0
    decay_rate: Annotated[
        float, rule("How fast the learning rate falls with observations.", ge=0, le=1000)
    ] = 0.1
    min_alpha: Annotated[
        float, rule("Lowest learning rate: what keeps change visible.", gt=0, le=1)
    ] = 0.1
    intensity_max: Annotated[
        float, rule("Intensity at which the weight is largest.", "0-255", gt=0, le=255)
    ] = 255.0

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.decay_rate > 0 and (1 / self.min_alpha - 1) / self.decay_rate > MAX_COUNT:
            raise ValueError(
                f"decay_rate {self.decay_rate:g} with min_alpha {self.min_alpha:g} needs more "
                f"than {MAX_COUNT} pings to settle; allowed: raise either of them"
            )


class ArcConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The arc rule; the classes of its maps. Levels are those of 8-bit images."""

    prior: Annotated[
        float, rule("Probability that an unobserved voxel is occupied.", ge=0.001, le=0.4)
    ] = 0.05
    occupied_threshold: Annotated[
        float, rule("Voxels above this probability are occupied.", live=True, gt=0, lt=1)
    ] = 0.12
    free_threshold: Annotated[
        float,
        rule(
            "Observed voxels below this probability are free, from here to "
            "occupied_threshold uncertain; at most that.",
            live=True,
            gt=0,
            lt=1,
        ),
    ] = 0.03
    level: Annotated[
        float,
        rule(
            "Level of a surface on the beam's axis; 0 estimates it from the first returns of the "
            "session.",
            "0-255",
            ge=0,
            le=255,
        ),
    ] = 0.0
    beam_width: Annotated[
        float,
        rule(
            "Vertical width of the beam one way, of the data sheet: 20 for M750d, M3000d and "
            "M1200d at low frequency, 12 for M1200d at high frequency.",
            "deg",
            ge=1,
            le=60,
        ),
    ] = 20.0
    lowest: Annotated[float, rule("Floor of the log-odds.", "log-odds", ge=-14, lt=0)] = -6.0
    highest: Annotated[float, rule("Ceiling of the log-odds.", "log-odds", ge=0, le=8)] = 6.0
    max_ratio: Annotated[
        float,
        rule("Part of a step downwards that a voxel surely occupied takes.", ge=0, le=1),
    ] = 0.6
    spread_below: Annotated[
        float,
        rule("Spread of the logarithm of levels below that of a surface.", ge=0.05, le=10),
    ] = 0.45
    spread_above: Annotated[
        float, rule("The same of levels above that of a surface.", ge=0.05, le=10)
    ] = 1.0
    broad_share: Annotated[
        float, rule("Share of surfaces that return any level.", ge=0, le=0.99)
    ] = 0.3
    missed_share: Annotated[
        float, rule("Share of surfaces that return nothing.", ge=0.001, le=0.9)
    ] = 0.01

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.free_threshold > self.occupied_threshold:
            raise ValueError(
                f"free_threshold {self.free_threshold:g} is above occupied_threshold "
                f"{self.occupied_threshold:g}; allowed: at most that"
            )
        if self.lowest >= self.prior_log_odds:
            raise ValueError(
                f"lowest {self.lowest:g} is not below the log-odds of the prior, "
                f"{self.prior_log_odds:.3g}; allowed: below that"
            )

    @property
    def prior_log_odds(self) -> float:
        """Log-odds of an unobserved voxel."""
        return math.log(self.prior / (1 - self.prior))


class AdaptiveConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Protection of what is believed against single contrary observations."""

    update: Annotated[bool, rule("Scale steps that contradict the map.")] = True
    threshold: Annotated[
        float,
        rule(
            "Probability below which occupied steps are scaled; free ones above 1 minus it.",
            gt=0,
            le=1,
        ),
    ] = 0.5
    max_ratio: Annotated[float, rule("Factor of the most scaled step.", ge=0, le=1)] = 0.3
    min_ratio: Annotated[
        float,
        rule(
            "Scaled occupied steps are at least this part of L_occ w, so that a voxel believed "
            "free comes back; at most max_ratio. With 0, as published, three free pings make a "
            "voxel free for good.",
            ge=0,
            le=1,
        ),
    ] = 0.25
    protect_occupied: Annotated[bool, rule("Scale free steps as well.")] = True

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.min_ratio > self.max_ratio:
            raise ValueError(
                f"min_ratio {self.min_ratio:g} is above max_ratio {self.max_ratio:g}; "
                "allowed: at most that"
            )


class ProcessingConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Load."""

    frame_skip: Annotated[
        int,
        rule("Map every Nth ping, count the rest as dropped.", "pings", live=True, ge=1, le=1000),
    ] = 1


class Config(Struct, frozen=True, forbid_unknown_fields=True):
    """The whole tree; `Config()` is a working default."""

    sonar: SonarConfig = SonarConfig()
    filtering: FilteringConfig = FilteringConfig()
    mounting: MountingConfig = MountingConfig()
    octree: OctreeConfig = OctreeConfig()
    mapping: MappingConfig = MappingConfig()
    iwlo: IwloConfig = IwloConfig()
    adaptive: AdaptiveConfig = AdaptiveConfig()
    arc: ArcConfig = ArcConfig()
    processing: ProcessingConfig = ProcessingConfig()
    time_sync: TimeSyncConfig = TimeSyncConfig()
    slam_quality: SlamQualityConfig = SlamQualityConfig()
    odometry: OdometryFusionConfig = OdometryFusionConfig()
    world_init: WorldInitConfig = WorldInitConfig()
    crosstalk: CrosstalkConfig = CrosstalkConfig()
    terrain_detection: TerrainDetectionConfig = TerrainDetectionConfig()
    robot_detection: RobotDetectionConfig = RobotDetectionConfig()
    outofcore: OutOfCoreConfig = OutOfCoreConfig()
    localization: LocalizationConfig = LocalizationConfig()
    amcl: AmclConfig = AmclConfig()
    device: DeviceConfig = DeviceConfig()
    water: WaterConfig = WaterConfig()
    recording: RecordingConfig = RecordingConfig()
    service: ServiceConfig = ServiceConfig()
    behind: BacklogConfig = BacklogConfig()
    server: ServerConfig = ServerConfig()
    stream: StreamConfig = StreamConfig()
    mqtt: MqttConfig = MqttConfig()
    topics: TopicsConfig = TopicsConfig()
    ros2: Ros2Config = Ros2Config()
    mavlink: MavlinkConfig = MavlinkConfig()
    changes: ChangesConfig = ChangesConfig()
    export: ExportConfig = ExportConfig()
    frames: FramesConfig = FramesConfig()
    visualization: VisualizationConfig = VisualizationConfig()

    def __post_init__(self) -> None:
        """Check what no single section can."""
        robots, terrain = self.robot_detection, self.terrain_detection
        if robots.enabled and robots.min_threshold < terrain.max_threshold:
            raise ValueError(
                f"robot_detection.min_threshold {robots.min_threshold:g} is below "
                f"terrain_detection.max_threshold {terrain.max_threshold:g}; allowed: at least that"
            )
        if robots.enabled and robots.keep_out and self.mapping.carve_no_return:
            raise ValueError(
                "robot_detection.keep_out with mapping.carve_no_return frees the shadows of "
                "robots; allowed: one of them"
            )
        min_m = MIN_TILE_VOXELS * self.octree.voxel_resolution
        if self.outofcore.use and self.outofcore.tile_size < min_m:
            raise ValueError(
                f"outofcore.tile_size {self.outofcore.tile_size:g} is less than "
                f"{MIN_TILE_VOXELS} voxels of {self.octree.voxel_resolution:g} m; "
                "allowed: at least that"
            )

    @property
    def class_limits(self) -> MappingConfig | ArcConfig:
        """Section with the thresholds in force, those of the rule."""
        return self.arc if self.mapping.rule == "arc" else self.mapping

    @property
    def occupied_threshold(self) -> float:
        """Voxels above this probability are occupied."""
        return self.class_limits.occupied_threshold

    @property
    def free_threshold(self) -> float:
        """Observed voxels below this probability are free."""
        return self.class_limits.free_threshold
