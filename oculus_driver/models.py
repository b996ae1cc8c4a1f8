"""Sonar models by part number, with range, field of view and ping rate.

Ranges and frequencies are from the vendor's published viewer, angles from data sheets and other
drivers. They are labels and limits. The field of view of a ping follows from its bearings, its
frequency from its own field.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from oculus_driver.wire import PingRate

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class ModeSpec:
    """One master mode of a family. None = unknown.

    Attributes:
        max_range_m: largest range that can be requested.
        frequency_hz: nominal.
        aperture_deg: horizontal field of view, edge to edge.
        elevation_deg: vertical beam width; two values if older and newer units differ, because the
            part number does not distinguish them.
        resolution_deg: horizontal beam width. Beams are spaced more densely.
    """

    max_range_m: float
    frequency_hz: float | None = None
    aperture_deg: float | None = None
    elevation_deg: tuple[float, ...] | None = None
    resolution_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Family:
    """Common properties of one type of sonar.

    Attributes:
        name: as the vendor writes it.
        modes: mode 1 (low frequency, wide) and, if it exists, mode 2 (high frequency, narrow).
    """

    name: str
    modes: tuple[ModeSpec, ...]

    @property
    def max_range_m(self) -> tuple[float, float | None]:
        """Largest range of modes 1 and 2; None if the mode does not exist."""
        return self.modes[0].max_range_m, self.modes[1].max_range_m if len(self.modes) > 1 else None


@dataclass(frozen=True, slots=True)
class Model:
    """One part number."""

    part_number: int
    name: str
    family: Family


BEAMS: Final = (256, 512)
"""Numbers of beams of every model, in both modes."""

MAX_RATE_HZ: Final[Mapping[PingRate, float]] = {
    PingRate.LOWEST: 2.0,
    PingRate.LOW: 5.0,
    PingRate.NORMAL: 10.0,
    PingRate.HIGH: 15.0,
    PingRate.HIGHEST: 40.0,
    PingRate.STANDBY: 0.0,
}
"""Maximum pings per second of a rate setting."""

M370S: Final = Family("M370s", (ModeSpec(200.0, 375e3, elevation_deg=(20.0,)),))
C550D: Final = Family("C550d", (ModeSpec(100.0, 550e3), ModeSpec(30.0, 820e3)))
M750D: Final = Family(
    "M750d",
    (ModeSpec(120.0, 750e3, 130.0, (20.0,), 1.0), ModeSpec(40.0, 1.2e6, 70.0, (12.0, 20.0), 0.6)),
)
M1200D: Final = Family(
    "M1200d",
    (ModeSpec(40.0, 1.2e6, 130.0, (20.0,), 0.6), ModeSpec(10.0, 2.1e6, 60.0, (12.0,), 0.4)),
)
M3000D: Final = Family(
    "M3000d",
    (ModeSpec(30.0, 1.2e6, 130.0, (20.0,), 0.6), ModeSpec(5.0, 3.0e6, 40.0, (20.0,), 0.4)),
)
UNKNOWN: Final = Family("unknown", (ModeSpec(120.0), ModeSpec(40.0)))

FAMILIES: Final = (M750D, M1200D, M3000D, M370S, C550D, UNKNOWN)

_NAMES: Final[dict[Family, dict[int, str]]] = {
    M750D: {
        1032: "M750d",
        2419: "MT750d",
        1434: "MD750d",
        1921: "MD750d (Burton)",
        1244: "MD750d (Impulse)",
        1134: "MF750d",
        1135: "MA750d",
    },
    M1200D: {
        1042: "M1200d",
        2420: "MT1200d",
        1435: "MD1200d",
        2086: "MD1200d (Burton)",
        1219: "MD1200d (Impulse)",
        1437: "MF1200d",
        1228: "MA1200d",
    },
    M370S: {
        1041: "M370s",
        2418: "MT370s",
        1433: "MD370s",
        2294: "MD370s (Burton)",
        1217: "MD370s (Impulse)",
        1436: "MF370s",
        1229: "MA370s",
        1209: "M373s",
        1218: "M373s Deep",
    },
    M3000D: {
        2203: "M3000d",
        2599: "MT3000d",
        2659: "MD3000d (Burton)",
        2658: "MD3000d (Impulse)",
        2466: "MF3000d",
        2924: "MA3000d",
    },
    C550D: {4713: "C550d"},
    UNKNOWN: {1220: "N1200s", 1221: "N1200s Deep"},
}

MODELS: Final[Mapping[int, Model]] = {
    number: Model(number, name, family)
    for family, names in _NAMES.items()
    for number, name in names.items()
}


def model_of(part_number: int) -> Model:
    """Return the model; an unknown part number gives a model of family `UNKNOWN`, not an error."""
    return MODELS.get(part_number) or Model(part_number, f"part {part_number}", UNKNOWN)


def max_rate_hz(ping_rate: PingRate, range_m: float, speed_of_sound_mps: float = 1500.0) -> float:
    """Return the maximum pings per second by rate setting and travel time.

    Network and sonar may be slower.

    Args:
        ping_rate: the setting.
        range_m: greater than 0. The next ping waits for the last echo of the previous one.
        speed_of_sound_mps: greater than 0.
    """
    return min(MAX_RATE_HZ[ping_rate], speed_of_sound_mps / (2.0 * range_m))
