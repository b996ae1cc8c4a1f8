"""Settings of an odometry format: which it is, and what its bytes do not say."""

from typing import Annotated, Literal

from msgspec import Struct

from mapperd.config.field import rule

__all__ = ["FormatName", "FormatSettings"]

FormatName = Literal[
    "native",
    "native_json",
    "native_serial",
    "mavlink",
    "water_linked_json",
    "water_linked_serial",
    "nmea",
]


class FormatSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """One source's format."""

    format: Annotated[FormatName, rule("What the bytes are, see docs/odometry.md.")] = "native"
    mavlink_system_id: Annotated[
        int, rule("Only this MAVLink system is heard; 0 hears all.", ge=0, le=255)
    ] = 1
    mavlink_component_id: Annotated[
        int, rule("Only this component of it is heard; 0 hears all.", ge=0, le=255)
    ] = 1
    water_density: Annotated[
        float,
        rule("Turns pressure into depth: sea 1025, fresh water 998.", "kg/m3", ge=900, le=1300),
    ] = 1025.0
    surface_pressure: Annotated[
        float, rule("Air pressure at the surface.", "hPa", ge=500, le=1100)
    ] = 1013.25
