"""What a command says about the files that it has made."""

from collections.abc import Iterator
from pathlib import Path

from mapperd.errors import ExportError
from mapperd.export.by_suffix import FORMATS, crs_of, write_map
from mapperd.export.cells import Heights
from mapperd.geodesy import Origin
from mapperd.mapping import SonarMap

__all__ = ["check_suffix", "make_files"]


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


def make_files(sonar_map: SonarMap, path: Path, origin: Origin | None) -> Iterator[str]:
    """Write a map; yields a line for each file, and one for the system of coordinates.

    Raises:
        ExportError: as `write_map`, and MapError.
    """
    heights = sonar_map.config.export
    for file in write_map(sonar_map, path, Heights(heights.min_z, heights.max_z), origin):
        yield f"{file}: {file.stat().st_size} bytes"
    crs = crs_of(path, origin)
    if crs is not None:
        yield f"system of coordinates: {crs}"
