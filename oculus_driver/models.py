"""Which sonar a part number is, and how far it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Family:
    """What sonars of one kind have in common.

    Attributes:
        name: as the maker writes it.
        max_range_m: largest range of modes 1 and 2; None where the mode does not exist.
    """

    name: str
    max_range_m: tuple[float, float | None]


@dataclass(frozen=True, slots=True)
class Model:
    """One part number."""

    part_number: int
    name: str
    family: Family


M370S: Final = Family("M370s", (200.0, None))
C550D: Final = Family("C550d", (100.0, 30.0))
M750D: Final = Family("M750d", (120.0, 40.0))
M1200D: Final = Family("M1200d", (40.0, 10.0))
M3000D: Final = Family("M3000d", (30.0, 5.0))
UNKNOWN: Final = Family("unknown", (120.0, 40.0))

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

_MODELS: Final = {
    number: Model(number, name, family)
    for family, names in _NAMES.items()
    for number, name in names.items()
}


def model_of(part_number: int) -> Model:
    """Return the model; an unknown part number is a model of family `UNKNOWN`, never an error."""
    return _MODELS.get(part_number) or Model(part_number, f"part {part_number}", UNKNOWN)
