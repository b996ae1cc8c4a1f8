"""Settings of the sonar, of the water, and of the filters of its images."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = [
    "IPV4",
    "CrosstalkConfig",
    "DeviceConfig",
    "RobotDetectionConfig",
    "TerrainDetectionConfig",
    "WaterConfig",
]

IPV4 = r"((25[0-5]|2[0-4]\d|1?\d?\d)\.){3}(25[0-5]|2[0-4]\d|1?\d?\d)"
"""Pattern of an address in dotted decimals."""


class DeviceConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The sonar on the network and what it is asked for; a recording needs none of it."""

    address: Annotated[
        str,
        rule(
            "Address of the sonar; empty discovers it by its status broadcasts.",
            "an IPv4 address or nothing",
            pattern=f"^({IPV4})?$",
        ),
    ] = ""
    port: Annotated[int, rule("TCP port of the sonar.", ge=1, le=65535)] = 52100
    serial: Annotated[
        int,
        rule(
            "Serial number of the sonar to use; 0 selects the first one discovered.",
            ge=0,
            le=2**32 - 1,
        ),
    ] = 0
    mode: Annotated[
        Literal[1, 2],
        rule("1 is low frequency, wide and far; 2 is high, narrow and near.", live=True),
    ] = 1
    ping_rate: Annotated[
        Literal["normal", "high", "highest", "low", "lowest"],
        rule("At most 10, 15, 40, 5 or 2 pings a second; long ranges allow fewer.", live=True),
    ] = "normal"
    standby: Annotated[bool, rule("The sonar does not ping, but stays connected.", live=True)] = (
        False
    )
    range: Annotated[
        float,
        rule("Range of the pings, as far as the model reaches.", "m", live=True, ge=0.1, le=200),
    ] = 10.0
    gain: Annotated[float, rule("Gain of the receiver.", "%", live=True, ge=0, le=100)] = 50.0
    gain_assist: Annotated[
        bool,
        rule("The sonar selects its gain by itself; in mode 2 it may have no effect.", live=True),
    ] = False
    gamma: Annotated[
        int,
        rule("Exponent of the image, in 255ths; 0 and 255 are linear.", live=True, ge=0, le=255),
    ] = 255
    beams: Annotated[Literal[256, 512], rule("Number of beams.", live=True)] = 512
    bits_per_sample: Annotated[
        Literal[8, 16, 32],
        rule(
            "8, 16, or 32 without time-varying gain: two and four times the data of 8.", live=True
        ),
    ] = 8
    latency_sec: Annotated[
        float,
        rule(
            "Minimum latency from the last echo to the first byte's arrival. The stream does "
            "not contain it; ping times are corrected by it.",
            "s",
            ge=0,
            le=1,
        ),
    ] = 0.0


class WaterConfig(Struct, frozen=True, forbid_unknown_fields=True):
    """The water, which sets the speed of sound; the sonar gets it."""

    salinity: Annotated[
        float, rule("0 in fresh water, 35 in the sea.", "ppt", live=True, ge=0, le=40)
    ] = 35.0
    temperature: Annotated[
        float,
        rule(
            "Measured temperature, from which the speed of sound is computed; 0: the sonar "
            "measures it.",
            "°C",
            live=True,
            ge=0,
            le=40,
        ),
    ] = 0.0
    speed_of_sound: Annotated[
        float,
        rule(
            "Measured speed of sound, 1300 to 1700; 0: it is computed from salinity and "
            "temperature.",
            "m/s",
            live=True,
            ge=0,
            le=1700,
        ),
    ] = 0.0
    correct_ranges: Annotated[
        bool,
        rule(
            "Scale ranges of pings that were made with another speed of sound, such as a "
            "recording from fresh water with 35 ppt.",
            live=True,
        ),
    ] = False

    def __post_init__(self) -> None:
        """Check what limits cannot express."""
        if 0 < self.speed_of_sound < 1300:  # noqa: PLR2004 written in the message
            raise ValueError(
                f"speed_of_sound {self.speed_of_sound:g} is below 1300; allowed: 0, or 1300 to "
                "1700 (m/s)"
            )


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
