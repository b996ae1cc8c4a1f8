"""Settings of the way from a ping to a scan, and of localization beyond the published names."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["LocalizationConfig", "ScanExtractionConfig"]


class ScanExtractionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """From a ping to one range a beam: the first surface."""

    equalise: Annotated[
        bool, rule("Take noise that varies over range and over beams off first.", live=True)
    ] = True
    guard: Annotated[
        float,
        rule(
            "Around a sample, left out of its background: a pulse's length.",
            "m",
            live=True,
            ge=0,
            le=10,
        ),
    ] = 0.05
    window: Annotated[
        float,
        rule("Before and behind a sample: its background.", "m", live=True, gt=0, le=100),
    ] = 0.5
    threshold: Annotated[
        float,
        rule("A return stands this far above its background.", "dB", live=True, ge=0, le=100),
    ] = 12.0
    min_intensity: Annotated[
        float,
        rule("And is at least this bright, as displayed.", "0-255", live=True, ge=0, le=255),
    ] = 12.0
    min_run: Annotated[
        int, rule("Samples in a row that make a return.", "samples", live=True, ge=1, le=100)
    ] = 3
    beam_width: Annotated[
        float,
        rule(
            "Of the sonar, -3 dB: over it an echo's top is searched behind its beginning.",
            "deg",
            live=True,
            gt=0,
            le=30,
        ),
    ] = 1.0
    place: Annotated[
        Literal["leading_edge", "peak"],
        rule("Where on a return its range is: at half its height, or its top.", live=True),
    ] = "leading_edge"
    side_lobe_ratio: Annotated[
        float,
        rule(
            "What lies at the range of an echo that is this much stronger is its side lobe.",
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
            "Returns from where floor or surface may be, where height or depth is known: weigh "
            "less, drop, or take as any other.",
            live=True,
        ),
    ] = "weigh"
    floor_quality: Annotated[float, rule("Factor of their quality.", live=True, ge=0, le=1)] = 0.3


class LocalizationConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Localization on a known map; `amcl` configures the filter."""

    mode: Annotated[
        Literal["off", "track", "global"],
        rule("Off; follow a pose that is roughly known; or find it anywhere on the map."),
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
        rule("Of the saved pose; without one it lies in the state directory.", "a path or nothing"),
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
            "Of 3d: elevations that a return may come from, in the beam's one-way width; the best "
            "counts.",
            live=True,
            ge=1,
            le=32,
        ),
    ] = 5
    mapping: Annotated[
        Literal["odometry", "corrected", "off"],
        rule(
            "Pose of mapped pings: from odometry; from localization, and only "
            "while it is sure; or not at all."
        ),
    ] = "odometry"
    mapping_max_std: Annotated[
        float,
        rule(
            "Of corrected: the estimate is sure up to this standard deviation of the place.",
            "m",
            live=True,
            gt=0,
            le=1000,
        ),
    ] = 0.5
    mapping_max_std_yaw: Annotated[
        float,
        rule("And of the heading.", "deg", live=True, gt=0, le=360),
    ] = 5.0
    band_low: Annotated[
        float,
        rule(
            "The vehicle drives from this height of a map with heights on, map frame; equal to "
            "band_high: where the map has most free space.",
            "m",
            ge=-12000,
            le=12000,
        ),
    ] = 0.0
    band_high: Annotated[float, rule("And up to this height.", "m", ge=-12000, le=12000)] = 0.0
    random_seed: Annotated[
        int, rule("Of all random numbers: equal input, equal run.", ge=0, le=2**63 - 1)
    ] = 0
    tempering: Annotated[
        float,
        rule(
            "Exponent of likelihood_field_prob's product: beams that overlap are not as many "
            "votes; 0.1 to 0.3 for a sonar, 1 is as published.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    boundaries_only: Annotated[
        bool,
        rule(
            "Only cells or voxels beside free ones count as obstacles: thick walls have no inside. "
            "For maps that a sonar made, whose walls are as deep as echoes are long."
        ),
    ] = False
    update_max_interval: Annotated[
        float,
        rule(
            "An update is due after this long in any case; 0 never.", "s", live=True, ge=0, le=3600
        ),
    ] = 0.0
    sigma_floor_xy: Annotated[
        float,
        rule("Drift at rest, in a current.", "m/sqrt(s)", live=True, ge=0, le=100),
    ] = 0.0
    sigma_floor_yaw: Annotated[
        float, rule("Drift of the heading at rest.", "rad/sqrt(s)", live=True, ge=0, le=10)
    ] = 0.0
    max_step: Annotated[
        float,
        rule(
            "An odometry's step beyond this between scans is a fault, not a motion.",
            "m",
            live=True,
            gt=0,
            le=1e4,
        ),
    ] = 10.0
    search_poses: Annotated[
        int,
        rule(
            "Where nothing is known, the first scan is compared at so many poses anywhere, and "
            "particles are drawn from those; 0 spreads them blindly, as published.",
            live=True,
            ge=0,
            le=10**7,
        ),
    ] = 0
    search_sigma: Annotated[
        float,
        rule(
            "The hit sigma of that search: poses lie farther apart than the beams are sharp.",
            "m",
            gt=0,
            le=100,
        ),
    ] = 0.5
    tempering_spread: Annotated[
        float,
        rule(
            "Factor of the tempering while particles are spread over half a metre: scans in a row "
            "err alike, and no mode is to win by that.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    least_effective_share: Annotated[
        float,
        rule(
            "A scan counts less where else less than this share of the effective size was left; "
            "0 never.",
            live=True,
            ge=0,
            lt=1,
        ),
    ] = 0.0
    draw_exponent: Annotated[
        float,
        rule(
            "Particles are drawn by weights to this power and keep the rest: below 1 light modes "
            "stay alive; 1 is as published.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 1.0
    rival_interval: Annotated[
        float,
        rule(
            "Way after which a second cloud, drawn anywhere by the scan, is tried against the "
            "first; needs search_poses and likelihood_field_prob; 0 never.",
            "m",
            live=True,
            ge=0,
            le=1e6,
        ),
    ] = 0.0
    rival_tempering: Annotated[
        float,
        rule(
            "Factor of the tempering in that trial.",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 0.25
    min_hit_share: Annotated[
        float,
        rule(
            "Where fewer returns than this share lie on the map for some time the estimate calls "
            "itself ambiguous, and rivals are tried at once; of likelihood_field_prob.",
            live=True,
            ge=0,
            le=1,
        ),
    ] = 0.4
    scan: ScanExtractionConfig = ScanExtractionConfig()
