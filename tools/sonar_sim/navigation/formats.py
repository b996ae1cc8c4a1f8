"""Odometry formats by name."""

from typing import Protocol

from sonar_sim.errors import SonarSimError
from sonar_sim.navigation.fix import Fix
from sonar_sim.navigation.nmea import Nmea
from sonar_sim.navigation.water_linked import WaterLinkedJson, WaterLinkedSerial
from sonar_sim.scene.vehicle import odometry_record

__all__ = ["FORMATS", "Format", "format_named"]


class Native:
    """Every fix, stamped with Unix time."""

    def encode(self, fix: Fix) -> list[bytes]:
        """Return one record."""
        return [odometry_record(fix.sample, fix.valid_ns)]


class Format(Protocol):
    """One odometry format."""

    def encode(self, fix: Fix) -> list[bytes]:
        """Return what is sent of a fix: datagrams, lines or sentences; perhaps none."""


FORMATS = (
    "native",
    "mavlink-odometry",
    "mavlink-ardusub",
    "mavlink-attitude",
    "waterlinked",
    "waterlinked-serial",
    "nmea",
)


def format_named(name: str) -> Format:
    """A format with its own counters.

    Raises:
        SonarSimError: there is no such format.
    """
    if name.startswith("mavlink-") and name in FORMATS:
        from sonar_sim.navigation import mavlink  # noqa: PLC0415 takes half a second to import

        if name == "mavlink-odometry":
            return mavlink.Px4()
        return mavlink.ArduSub(positions=name == "mavlink-ardusub")
    if name == "native":
        return Native()
    if name == "nmea":
        return Nmea()
    if name == "waterlinked":
        return WaterLinkedJson()
    if name == "waterlinked-serial":
        return WaterLinkedSerial()
    raise SonarSimError(f"odometry: no format {name!r}; there are {', '.join(FORMATS)}")
