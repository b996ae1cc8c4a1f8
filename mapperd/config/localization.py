"""Settings of the way from a ping to a scan, and of localization beyond AMCL's."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["LocalizationConfig", "ScanExtractionConfig"]


class ScanExtractionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """How a ping becomes one range per beam: that of the first surface."""

    equalise: Annotated[
        bool, rule("First subtract noise that varies over range and beams.", live=True)
    ] = True
    guard: Annotated[
        float,
        rule(
            "Distance around a sample that its background excludes: the pulse length.",
            "m",
            live=True,
            ge=0,
            le=10,
        ),
    ] = 0.05
    window: Annotated[
        float,
        rule("Length of the background before and after a sample.", "m", live=True, gt=0, le=100),
    ] = 0.5
    threshold: Annotated[
        float,
        rule("Minimum level of a return above its background.", "dB", live=True, ge=0, le=100),
    ] = 12.0
    min_intensity: Annotated[
        float,
        rule("Minimum intensity of a return, as displayed.", "0-255", live=True, ge=0, le=255),
    ] = 12.0
    min_run: Annotated[
        int,
        rule(
            "Minimum number of consecutive samples of a return.", "samples", live=True, ge=1, le=100
        ),
    ] = 3
    beam_width: Annotated[
        float,
        rule(
            "Beam width of the sonar at -3 dB; over it the peak of an echo is searched after "
            "its start.",
            "deg",
            live=True,
            gt=0,
            le=30,
        ),
    ] = 1.0
    place: Annotated[
        Literal["leading_edge", "peak"],
        rule("Point of a return that gives its range: half its height, or its peak.", live=True),
    ] = "leading_edge"
    side_lobe_ratio: Annotated[
        float,
        rule(
            "An echo this much weaker than another one at its range is a side lobe.",
            "dB",
            live=True,
            gt=0,
            le=100,
        ),
    ] = 20.0
    burst_share: Annotated[
        float,
        rule(
            "A ping is skipped if more beams than this changed by more than the vehicle moves.",
            "0-1",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 0.3
    floor_gate: Annotated[
        Literal["weigh", "drop", "off"],
        rule(
            "Treatment of returns that may come from the floor or the surface, if height or "
            "depth is known: reduce their weight, drop them, or none.",
            live=True,
        ),
    ] = "weigh"
    floor_quality: Annotated[
        float, rule("Factor on the weight of these returns.", live=True, ge=0, le=1)
    ] = 0.3


class LocalizationConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Localization on a known map; `amcl` configures the filter."""

    mode: Annotated[
        Literal["off", "track", "global"],
        rule("`track` follows an approximately known pose; `global` finds it anywhere on the map."),
    ] = "off"
    map_path: Annotated[
        str,
        rule(
            "The known map: a grid's .yaml, a .map, or a map's file on disk.",
            "a path or nothing",
        ),
    ] = ""
    pose_path: Annotated[
        str,
        rule("Path of the saved pose; default: in the state folder.", "a path or nothing"),
    ] = ""
    geometry: Annotated[
        Literal["2d", "3d"],
        rule(
            "Compare scans with a slice of the map, or with all of it under the ping's full "
            "geometry."
        ),
    ] = "3d"
    elevations: Annotated[
        int,
        rule(
            "With 3d: number of elevations at which a return is compared, within the beam's "
            "one-way width; the best counts.",
            live=True,
            ge=1,
            le=32,
        ),
    ] = 5
    mapping: Annotated[
        Literal["odometry", "corrected", "off"],
        rule(
            "Pose of mapped pings: from odometry; from localization while it is certain; or "
            "map none."
        ),
    ] = "odometry"
    mapping_max_std: Annotated[
        float,
        rule(
            "With `corrected`: maximum standard deviation of a certain position.",
            "m",
            live=True,
            gt=0,
            le=1000,
        ),
    ] = 0.5
    mapping_max_std_yaw: Annotated[
        float,
        rule(
            "With `corrected`: maximum standard deviation of a certain heading.",
            "deg",
            live=True,
            gt=0,
            le=360,
        ),
    ] = 5.0
    band_low: Annotated[
        float,
        rule(
            "Lowest height of the vehicle on a 3D map, map frame; if equal to band_high, the "
            "height with the most free space.",
            "m",
            ge=-12000,
            le=12000,
        ),
    ] = 0.0
    band_high: Annotated[
        float, rule("Highest height of the vehicle.", "m", ge=-12000, le=12000)
    ] = 0.0
    random_seed: Annotated[
        int,
        rule("Seed of all random numbers; equal input gives equal results.", ge=0, le=2**63 - 1),
    ] = 0
    tempering: Annotated[
        float,
        rule(
            "Exponent of likelihood_field_prob's product, because overlapping beams are not "
            "independent; 0.1 to 0.3 for a sonar, 1 as in AMCL.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    boundaries_only: Annotated[
        bool,
        rule(
            "Only cells or voxels beside free ones are obstacles. For sonar maps, whose "
            "walls are as thick as echoes are long."
        ),
    ] = False
    update_max_interval: Annotated[
        float,
        rule("Maximum time between updates; 0: no limit.", "s", live=True, ge=0, le=3600),
    ] = 0.0
    sigma_floor_xy: Annotated[
        float,
        rule(
            "Drift of the position at rest, as in a current.", "m/sqrt(s)", live=True, ge=0, le=100
        ),
    ] = 0.0
    sigma_floor_yaw: Annotated[
        float, rule("Drift of the heading at rest.", "rad/sqrt(s)", live=True, ge=0, le=10)
    ] = 0.0
    max_step: Annotated[
        float,
        rule(
            "A larger step of the odometry between scans counts as a fault.",
            "m",
            live=True,
            gt=0,
            le=1e4,
        ),
    ] = 10.0
    search_poses: Annotated[
        int,
        rule(
            "Without a known pose, the first scan is compared at this many random poses, "
            "from which particles are drawn; 0 draws them uniformly, as AMCL does.",
            live=True,
            ge=0,
            le=10**7,
        ),
    ] = 0
    search_sigma: Annotated[
        float,
        rule(
            "Standard deviation of a hit in that search, whose poses are far apart.",
            "m",
            gt=0,
            le=100,
        ),
    ] = 0.5
    tempering_spread: Annotated[
        float,
        rule(
            "Factor on the tempering while particles are spread over half a metre, because "
            "errors of consecutive scans are correlated.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    least_effective_share: Annotated[
        float,
        rule(
            "The weight of a scan is reduced so that at least this share of the effective "
            "sample size remains; 0 never.",
            live=True,
            ge=0,
            lt=1,
        ),
    ] = 0.0
    draw_exponent: Annotated[
        float,
        rule(
            "Particles are drawn by weights to this power and keep the rest; below 1 weak "
            "modes survive; 1 as in AMCL.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    alternative_interval: Annotated[
        float,
        rule(
            "Distance after which particles drawn anywhere by the scan are compared with the "
            "estimate; in parts of it poses are verified against distant ones; needs search_poses "
            "and likelihood_field_prob; 0 never.",
            "m",
            live=True,
            ge=0,
            le=1e6,
        ),
    ] = 0.0
    alternative_tempering: Annotated[
        float,
        rule(
            "Factor on the tempering in that comparison.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 0.25
    min_hit_share: Annotated[
        float,
        rule(
            "If a smaller share of returns lies on the map for some time, the estimate is "
            "ambiguous and alternatives are tried at once; likelihood_field_prob only.",
            live=True,
            ge=0,
            le=1,
        ),
    ] = 0.4
    scan: ScanExtractionConfig = ScanExtractionConfig()
