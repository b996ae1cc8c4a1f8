"""Settings of the filters on a ping's image: crosstalk, and robots by their brightness."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["CrosstalkConfig", "RobotDetectionConfig", "TerrainDetectionConfig"]


class CrosstalkConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Removal of stripes: rings at one range over all beams, from another sound source."""

    enabled: Annotated[bool, rule("Remove stripes, before all other filters.", live=True)] = False
    morpho_enabled: Annotated[
        bool,
        rule(
            "Only what is thinner in range than an opening's kernel counts; without, thick echoes "
            "count as well.",
            live=True,
        ),
    ] = True
    morpho_kernel_size: Annotated[
        int,
        rule("Height of the kernel: stripes are thinner.", "rows", live=True, ge=2, le=101),
    ] = 5
    morpho_kernel_shape: Annotated[
        Literal["rect", "ellipse", "cross"],
        rule(
            "Kernel over three sectors of the fan: rect asks most of an echo that is not a stripe.",
            live=True,
        ),
    ] = "rect"
    azimuth_enabled: Annotated[
        bool,
        rule(
            "Only rows that stand out over the whole fan count; without, thin echoes count as "
            "well.",
            live=True,
        ),
    ] = True
    azimuth_threshold: Annotated[
        float,
        rule(
            "Share of the sectors, in each third of the fan, that a stripe stands out in.",
            "0-1",
            live=True,
            gt=0,
            le=1,
        ),
    ] = 0.5
    fft_enabled: Annotated[
        bool,
        rule(
            "Also notch what is constant over the beams in the image's spectrum; dims floors seen "
            "flat, see docs/guides/filters.md.",
            live=True,
        ),
    ] = False
    filter_width: Annotated[
        float,
        rule(
            "Width of the notch, over the beams' highest frequency.",
            "0-1",
            live=True,
            ge=0.001,
            le=1,
        ),
    ] = 0.02
    filter_strength: Annotated[
        float, rule("Share of the notched part that is removed.", "0-1", live=True, ge=0, le=1)
    ] = 0.8
    dc_preserve_ratio: Annotated[
        float,
        rule(
            "Slow changes over range that the notch leaves, over the rows' highest frequency.",
            "0-1",
            live=True,
            ge=0,
            le=0.5,
        ),
    ] = 0.05


class TerrainDetectionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Intensities of terrain, while `robot_detection.enabled`; others are not terrain."""

    min_threshold: Annotated[
        float, rule("Minimum intensity of terrain.", "0-255", live=True, ge=0, le=255)
    ] = 80.0
    max_threshold: Annotated[
        float, rule("Terrain is darker than this.", "0-255", live=True, ge=0, le=255)
    ] = 180.0

    def __post_init__(self) -> None:
        """Check what no single field can."""
        if self.min_threshold >= self.max_threshold:
            raise ValueError(
                f"min_threshold {self.min_threshold:g} is not below max_threshold "
                f"{self.max_threshold:g}; allowed: below it"
            )


class RobotDetectionConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """Detection of other robots by their brightness."""

    enabled: Annotated[bool, rule("Detect other robots.", live=True)] = False
    min_threshold: Annotated[
        float,
        rule(
            "Minimum intensity of a robot; at least terrain_detection.max_threshold.",
            "0-255",
            live=True,
            ge=0,
            le=255,
        ),
    ] = 180.0
    min_samples: Annotated[
        int,
        rule(
            "Minimum number of adjacent samples of a robot.", "samples", live=True, ge=1, le=100000
        ),
    ] = 4
    keep_out: Annotated[
        bool, rule("Robots stay out of the map; otherwise they are occupied in it.", live=True)
    ] = False
    expire_sec: Annotated[
        float, rule("A sighting is forgotten after this.", "s", live=True, gt=0, le=3600)
    ] = 10.0
    topic: Annotated[
        str,
        rule(
            "Name under which sightings are published.",
            "a topic",
            pattern="^/?[A-Za-z0-9_]{1,64}(/[A-Za-z0-9_]{1,64}){0,8}$",
        ),
    ] = "/sonar_robot_detections"
