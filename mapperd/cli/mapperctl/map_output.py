"""Files that a command makes of a map, and what it says about them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapperd.config.tree import Config
from mapperd.errors import ExportError
from mapperd.export.calibration import Calibration
from mapperd.export.cells import Heights
from mapperd.export.formats import FORMATS, crs_of, write_map
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.sonar_map import SonarMap

__all__ = ["MapOutput", "check_suffix", "make_files", "origin_among"]


@dataclass(frozen=True, slots=True)
class MapOutput:
    """Files that were written.

    Attributes:
        files: name to bytes.
        crs: the system of coordinates that they say they have; None where they cannot say.
    """

    files: dict[str, int]
    crs: str | None = None

    def lines(self) -> Iterator[str]:
        """For a person."""
        for name, size in self.files.items():
            yield f"{name}: {size} bytes"
        if self.crs is not None:
            yield f"system of coordinates: {self.crs}"

    def plain(self) -> dict[str, Any]:
        """For a program."""
        return {"files": self.files} if self.crs is None else {"files": self.files, "crs": self.crs}


def check_suffix(path: Path, others: tuple[str, ...] = ()) -> None:
    """Refuse a name that no format has, before any work is done.

    Args:
        path: of a file.
        others: suffixes that are allowed beside those of maps.

    Raises:
        ExportError: it is one.
    """
    known = (*FORMATS, *others)
    if path.suffix not in known:
        raise ExportError(f"{path.name}: no format has such a name; known: {' '.join(known)}")


def make_files(
    sonar_map: SonarMap, path: Path, origin: Origin | None, calibration: Calibration | None = None
) -> MapOutput:
    """Write a map, with the heights of its settings.

    Raises:
        ExportError: as `write_map`, and MapError.
    """
    heights = sonar_map.config.export
    window = Heights(heights.min_z, heights.max_z)
    files = write_map(sonar_map, path, window, origin, calibration)
    return MapOutput({str(file): file.stat().st_size for file in files}, crs_of(path, origin))


def origin_among(asked: Origin | None, said: Origin | None, config: Config) -> Origin | None:
    """The origin that was asked for, else the map's own, else that of the settings."""
    geo = config.odometry.origin
    of_settings = None if geo is None else Origin.of_degrees(geo.latitude, geo.longitude)
    return asked or said or of_settings
