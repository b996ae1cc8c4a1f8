"""Settings of localization against a known map, under the names of Beluga AMCL.

Names and defaults are those of Beluga AMCL, except those in `CORRECTED`: its document has them
transposed, or of another type than the formulas need. `mapperd.config.aliases` has the names
that other releases use.
"""

import math
from types import MappingProxyType
from typing import Annotated, Literal

from msgspec import Struct, structs

from mapperd.config.field import rule

__all__ = ["CORRECTED", "AmclConfig"]

CORRECTED = MappingProxyType(
    {
        "recovery_alpha_fast": ("0.001", "transposed: the fast average has the larger gain"),
        "recovery_alpha_slow": ("0.1", "transposed with recovery_alpha_fast"),
        "update_min_a": ("0.2", "transposed: pi/6 is an angle"),
        "update_min_d": ("0.523598", "transposed with update_min_a"),
        "save_pose_rate": ("0.5, a boolean", "of another type: it is a rate in Hz"),
    }
)
"""Settings whose default differs: Beluga AMCL's documented default, and what is wrong with it."""

MAX_CORRELATION = 1 + 1e-9
"""Rounding of a covariance that is just positive semi-definite."""

FRAME = "^[A-Za-z0-9_./-]{1,64}$"
TOPIC = "^/?[A-Za-z0-9_]{1,64}(/[A-Za-z0-9_]{1,64}){0,8}$"


class AmclConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The particle filter, with the parameters of Beluga AMCL."""

    base_frame_id: Annotated[
        str, rule("Name of the vehicle's frame, which is estimated.", "a name", pattern=FRAME)
    ] = "base_footprint"
    odom_frame_id: Annotated[
        str,
        rule(
            "Name of the odometry's frame, which is continuous and drifts.", "a name", pattern=FRAME
        ),
    ] = "odom"
    global_frame_id: Annotated[
        str,
        rule(
            "Name of the map's frame; an initial pose in another one is refused.",
            "a name",
            pattern=FRAME,
        ),
    ] = "map"
    map_topic: Annotated[str, rule("Topic of new maps.", "a topic", pattern=TOPIC)] = "map"
    use_map_topic: Annotated[
        bool,
        rule("Accept new maps on map_topic; otherwise the map of localization.map_path stays."),
    ] = True
    initial_pose_topic: Annotated[
        str, rule("Topic of initial poses.", "a topic", pattern=TOPIC)
    ] = "initialpose"

    set_initial_pose: Annotated[
        bool,
        rule(
            "On a new map without an estimate, start at the initial pose below; if false, "
            "anywhere on the map.",
            live=True,
        ),
    ] = False
    initial_pose_x: Annotated[
        float, rule("Mean of the initial pose, map frame.", "m", live=True, ge=-1e6, le=1e6)
    ] = 0.0
    initial_pose_y: Annotated[
        float, rule("Mean of the initial pose, map frame.", "m", live=True, ge=-1e6, le=1e6)
    ] = 0.0
    initial_pose_a: Annotated[
        float, rule("Mean heading, counter-clockwise.", "rad", live=True, ge=-100, le=100)
    ] = 0.0
    initial_cov_xx: Annotated[float, rule("Variance of x.", "m2", live=True, ge=0, le=1e12)] = 0.0
    initial_cov_yy: Annotated[float, rule("Variance of y.", "m2", live=True, ge=0, le=1e12)] = 0.0
    initial_cov_aa: Annotated[
        float, rule("Variance of the heading.", "rad2", live=True, ge=0, le=1e4)
    ] = 0.0
    initial_cov_xy: Annotated[
        float, rule("Covariance of x and y.", "m2", live=True, ge=-1e12, le=1e12)
    ] = 0.0
    initial_cov_xa: Annotated[
        float, rule("Covariance of x and heading.", "m rad", live=True, ge=-1e8, le=1e8)
    ] = 0.0
    initial_cov_ya: Annotated[
        float, rule("Covariance of y and heading.", "m rad", live=True, ge=-1e8, le=1e8)
    ] = 0.0
    always_reset_initial_pose: Annotated[
        bool,
        rule(
            "With set_initial_pose, each new map starts at the initial pose again; if false, "
            "at the last estimate.",
            live=True,
        ),
    ] = False
    save_pose_rate: Annotated[
        float,
        rule(
            "Rate at which the estimate is saved, to resume there after a restart; 0 or less "
            "never.",
            "Hz",
            live=True,
            ge=-1,
            le=100,
        ),
    ] = 0.5
    first_map_only: Annotated[bool, rule("Ignore maps after the first one.", live=True)] = False
    tf_broadcast: Annotated[
        bool,
        rule(
            "Publish the odometry frame in the map frame once a pose was set or global "
            "localization requested.",
            live=True,
        ),
    ] = True
    transform_tolerance: Annotated[
        float, rule("How far ahead that transform is stamped.", "s", live=True, ge=0, le=3600)
    ] = 1.0

    max_particles: Annotated[
        int,
        rule("Number of particles at the start, and the maximum.", live=True, ge=1, le=10_000_000),
    ] = 5000
    min_particles: Annotated[
        int,
        rule("Minimum number of particles; at most max_particles.", live=True, ge=1, le=10_000_000),
    ] = 100
    pf_z: Annotated[
        float,
        rule(
            "Quantile of the normal distribution, not a probability, that bounds the error of the "
            "cloud; 2.326 is 99 %.",
            live=True,
            gt=0,
            le=10,
        ),
    ] = 0.99
    pf_err: Annotated[
        float, rule("Error of the cloud (Kullback-Leibler).", live=True, gt=0, le=1)
    ] = 0.05
    spatial_resolution_x: Annotated[
        float, rule("Edge of the buckets of the KLD sampling.", "m", live=True, gt=0, le=1e4)
    ] = 0.5
    spatial_resolution_y: Annotated[
        float, rule("Edge of the buckets of the KLD sampling.", "m", live=True, gt=0, le=1e4)
    ] = 0.5
    spatial_resolution_theta: Annotated[
        float,
        rule("Angle of the buckets of the KLD sampling.", "rad", live=True, gt=0, le=2 * math.pi),
    ] = math.radians(10.0)
    recovery_alpha_fast: Annotated[
        float,
        rule(
            "Gain of the fast average of the scan's fit; random particles are added while it "
            "is below the slow one.",
            live=True,
            ge=0,
            le=1,
        ),
    ] = 0.1
    recovery_alpha_slow: Annotated[
        float,
        rule(
            "Gain of the slow average; at most that of the fast one; 0 disables recovery.",
            live=True,
            ge=0,
            le=1,
        ),
    ] = 0.001
    resample_interval: Annotated[
        int, rule("Resample at every Nth update.", "updates", live=True, ge=1, le=1000)
    ] = 2
    selective_resampling: Annotated[
        bool, rule("Resample only while the effective number of particles is below half of them.")
    ] = False
    update_min_a: Annotated[
        float,
        rule("Minimum turn between updates.", "rad", live=True, ge=0, le=2 * math.pi),
    ] = math.pi / 6
    update_min_d: Annotated[
        float,
        rule("Minimum distance between updates.", "m", live=True, ge=0, le=1e4),
    ] = 0.2
    execution_policy: Annotated[
        Literal["seq", "par"],
        rule("Compute particles on one core or on all; the result is the same.", live=True),
    ] = "seq"

    robot_model_type: Annotated[
        Literal["differential_drive", "omnidirectional_drive", "stationary"],
        rule("Error model of the odometry; vehicles that sway are omnidirectional.", live=True),
    ] = "differential_drive"
    odom_alpha1: Annotated[
        float, rule("Variance of turn per turn squared.", "1", live=True, ge=0, le=1e4)
    ] = 0.2
    odom_alpha2: Annotated[
        float, rule("Variance of turn per distance squared.", "rad2/m2", live=True, ge=0, le=1e4)
    ] = 0.2
    odom_alpha3: Annotated[
        float, rule("Variance of distance per distance squared.", "1", live=True, ge=0, le=1e4)
    ] = 0.2
    odom_alpha4: Annotated[
        float, rule("Variance of distance per turn squared.", "m2/rad2", live=True, ge=0, le=1e4)
    ] = 0.2
    odom_alpha5: Annotated[
        float,
        rule(
            "Variance of sideways distance per distance squared; omnidirectional only.",
            "1",
            live=True,
            ge=0,
            le=1e4,
        ),
    ] = 0.2

    laser_model_type: Annotated[
        Literal["likelihood_field", "likelihood_field_prob", "beam"],
        rule(
            "Weight of a scan: sum of cubes over a distance field, product over it, or ray "
            "casting on a planar map; of a 3D map, its slice at the vehicle's height.",
            live=True,
        ),
    ] = "likelihood_field"
    laser_max_range: Annotated[
        float,
        rule("Returns farther than this are dropped.", "m", live=True, gt=0, le=1e4),
    ] = 100.0
    laser_min_range: Annotated[
        float,
        rule(
            "Returns nearer than this are dropped, as those below filtering.min_range.",
            "m",
            live=True,
            ge=0,
            le=1e4,
        ),
    ] = 0.0
    max_beams: Annotated[
        int,
        rule("Number of beams of a scan that are used, evenly spaced.", live=True, ge=2, le=4096),
    ] = 60
    laser_sigma_hit: Annotated[
        float, rule("Standard deviation of a hit.", "m", live=True, gt=0, le=1000)
    ] = 0.2
    laser_z_hit: Annotated[float, rule("Weight of hits.", live=True, ge=0, le=1)] = 0.5
    laser_z_rand: Annotated[float, rule("Weight of random returns.", live=True, ge=0, le=1)] = 0.5
    laser_z_short: Annotated[
        float, rule("Weight of returns before the map's; beam only.", live=True, ge=0, le=1)
    ] = 0.05
    laser_lambda_short: Annotated[
        float, rule("Rate of these returns over range; beam only.", "1/m", live=True, gt=0, le=1e4)
    ] = 0.1
    laser_likelihood_max_dist: Annotated[
        float, rule("Maximum distance in the field.", "m", live=True, ge=0, le=1e4)
    ] = 2.0

    std_warn_level_x: Annotated[
        float, rule("Warn above this standard deviation.", "m", live=True, ge=0, le=1e6)
    ] = 0.2
    std_warn_level_y: Annotated[
        float, rule("Warn above this standard deviation.", "m", live=True, ge=0, le=1e6)
    ] = 0.2
    std_warn_level_yaw: Annotated[
        float, rule("Warn above this standard deviation.", "rad", live=True, ge=0, le=1e6)
    ] = 0.2
    restore_defaults: Annotated[
        bool,
        rule("Restore all `amcl` settings to those of the start; then false again.", live=True),
    ] = False

    def __post_init__(self) -> None:
        """Check what no single field can."""
        structs.force_setattr(self, "restore_defaults", False)  # noqa: FBT003 a value: at the start nothing is to be restored
        if self.min_particles > self.max_particles:
            raise ValueError(
                f"min_particles {self.min_particles} is above max_particles "
                f"{self.max_particles}; allowed: at most that"
            )
        if self.recovery_alpha_slow > self.recovery_alpha_fast:
            raise ValueError(
                f"recovery_alpha_slow {self.recovery_alpha_slow:g} is above recovery_alpha_fast "
                f"{self.recovery_alpha_fast:g}; allowed: at most that"
            )
        if self.laser_min_range >= self.laser_max_range:
            raise ValueError(
                f"laser_min_range {self.laser_min_range:g} is not below laser_max_range "
                f"{self.laser_max_range:g}; allowed: below it"
            )
        if self.laser_z_hit + self.laser_z_rand <= 0:
            raise ValueError("laser_z_hit and laser_z_rand are both 0; allowed: one of them above")
        if not self._covariance_possible():
            raise ValueError(
                "initial_cov_* is not a covariance: not positive semi-definite; allowed: "
                "covariances within what the variances permit"
            )

    def _covariance_possible(self) -> bool:
        """Positive semi-definite, by the correlations: their matrix has no negative minor."""
        x, y, a = (math.sqrt(getattr(self, f"initial_cov_{of}{of}")) for of in "xya")
        pairs = (
            (self.initial_cov_xy, x * y),
            (self.initial_cov_xa, x * a),
            (self.initial_cov_ya, y * a),
        )
        if any(abs(value) > MAX_CORRELATION * most for value, most in pairs):
            return False
        xy, xa, ya = (value / most if most > 0 else 0.0 for value, most in pairs)
        return 1 + 2 * xy * xa * ya - xy**2 - xa**2 - ya**2 >= 1 - MAX_CORRELATION
