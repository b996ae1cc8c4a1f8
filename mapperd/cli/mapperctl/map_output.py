"""Map files that a command writes, and how it reports them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapperd.config.tree import Config
from mapperd.errors import ExportError
from mapperd.export.calibration import ProbabilityCalibration
from mapperd.export.cells import Heights
from mapperd.export.formats import FORMATS, crs_of, write_map
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.queries import MapContent
from mapperd.store.map_files import SourcedMap

__all__ = ["MapOutput", "check_suffix", "make_files", "missing", "origin_among", "remarks_on"]


@dataclass(frozen=True, slots=True)
class MapOutput:
    """Written map files.

    Attributes:
        files: sizes in bytes by name.
        crs: coordinate reference system of the files; None if the format has none.
        bricks_lost: damaged bricks of the map that are missing in the files.
    """

    files: dict[str, int]
    crs: str | None = None
    bricks_lost: int = 0

    def lines(self) -> Iterator[str]:
        """Lines for people."""
        for name, size in self.files.items():
            yield f"{name}: {size} bytes"
        if self.crs is not None:
            yield f"coordinate reference system: {self.crs}"
        if self.bricks_lost:
            yield missing(self.bricks_lost)

    def plain(self) -> dict[str, Any]:
        """Values for JSON."""
        values: dict[str, Any] = {"files": self.files}
        if self.crs is not None:
            values["crs"] = self.crs
        if self.bricks_lost:
            values["bricks_lost"] = self.bricks_lost
        return values


def check_suffix(path: Path, others: tuple[str, ...] = ()) -> None:
    """Check the suffix of a file before any work is done.

    Args:
        path: path of the file.
        others: allowed suffixes in addition to those of maps.

    Raises:
        ExportError: no format has this suffix.
    """
    known = (*FORMATS, *others)
    if path.suffix not in known:
        raise ExportError(f"{path.name}: unknown format; known suffixes: {' '.join(known)}")


def make_files(
    sonar_map: MapContent,
    path: Path,
    origin: Origin | None,
    calibration: ProbabilityCalibration | None = None,
    *,
    bricks_lost: int = 0,
) -> MapOutput:
    """Write a map, of which damaged bricks may be missing, within the heights of its settings.

    Raises:
        ExportError, MapError: as `write_map`.
    """
    heights = sonar_map.config.export
    window = Heights(heights.min_z, heights.max_z)
    files = write_map(sonar_map, path, window, origin, calibration)
    sizes = {str(file): file.stat().st_size for file in files}
    return MapOutput(sizes, crs_of(path, origin), bricks_lost)


def remarks_on(path: Path, source: SourcedMap) -> Iterator[str]:
    """Yield what people must know of a map file: unverified settings, incomplete sessions."""
    if not source.has_checksum:
        yield f"{path}: a file of an earlier version, whose settings cannot be verified"
    if remarks := source.remarks():
        yield f"{path}: {remarks}"


def missing(bricks: int) -> str:
    """Return the line for people about damaged bricks that are missing in an output."""
    return f"{bricks} damaged bricks of the map are missing: their space is unknown"


def origin_among(asked: Origin | None, own: Origin | None, config: Config) -> Origin | None:
    """Return the requested origin, or the map's own, or that of the settings."""
    geo = config.odometry.origin
    of_settings = None if geo is None else Origin.of_degrees(geo.latitude, geo.longitude)
    return asked or own or of_settings
