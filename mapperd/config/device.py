"""Settings of the sonar on the network, and of the water that its ranges depend on."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["IPV4", "DeviceConfig", "WaterConfig"]

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
