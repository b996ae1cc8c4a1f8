"""A map as a file, in the format that the file's name asks for."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from mapperd.errors import ExportError, MapError
from mapperd.export.ascii_grid import write_ascii_grid
from mapperd.export.atomic import atomic_file
from mapperd.export.cells import Heights, known_cells, top_cells
from mapperd.export.nav2 import nav2_yaml, write_pgm
from mapperd.export.pcd import write_pcd
from mapperd.export.ply import write_ply
from mapperd.export.xyz import write_xyz
from mapperd.mapping import SonarMap

__all__ = ["FORMATS", "write_map"]

ALL = Heights()


def write_map(sonar_map: SonarMap, path: Path, heights: Heights = ALL) -> list[Path]:
    """Write one state of a map, whole or not at all, while pings may go on changing it.

    Args:
        sonar_map: in memory as a whole.
        path: its suffix is one of `FORMATS`.
        heights: what the flat formats, `.asc` and `.pgm`, look at.

    Returns:
        the files: `.pgm` has a `.yaml` beside it.

    Raises:
        ExportError: the suffix is no format, the file cannot be written, or the format cannot
            hold this map.
        MapError: the map is in tiles (`in_tiles`), or leaves OctoMap's reach (`out_of_reach`).
    """
    write = FORMATS.get(path.suffix)
    if write is None:
        raise ExportError(f"{path.name}: no format has such a name; known: {' '.join(FORMATS)}")
    if sonar_map.core.is_in_tiles:
        raise MapError("the map is in tiles: read it from its file", "in_tiles")
    return write(sonar_map, path, heights)


def _map(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    sonar_map.save(path)
    return [path]


def _bt(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    return _bytes(sonar_map.octomap_bt(), path)


def _ot(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    return _bytes(sonar_map.octomap_ot(), path)


def _ply(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    occupied = sonar_map.voxels("occupied")
    with atomic_file(path) as file:
        write_ply(file, occupied, sonar_map.resolution_m)
    return [path]


def _pcd(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    occupied = sonar_map.voxels("occupied")
    with atomic_file(path) as file:
        write_pcd(file, occupied, sonar_map.resolution_m)
    return [path]


def _xyz(sonar_map: SonarMap, path: Path, _: Heights) -> list[Path]:
    occupied = sonar_map.voxels("occupied")
    with atomic_file(path) as file:
        write_xyz(file, occupied)
    return [path]


def _asc(sonar_map: SonarMap, path: Path, heights: Heights) -> list[Path]:
    tops = top_cells(sonar_map, heights)
    with atomic_file(path) as file:
        write_ascii_grid(file, tops, sonar_map.resolution_m)
    return [path]


def _pgm(sonar_map: SonarMap, path: Path, heights: Heights) -> list[Path]:
    """Both files are written before either takes its place."""
    cells = known_cells(sonar_map, heights)
    beside = path.with_suffix(".yaml")
    with atomic_file(beside) as text, atomic_file(path) as picture:
        write_pgm(picture, cells)
        if cells is not None:
            text.write(nav2_yaml(path.name, cells, sonar_map.resolution_m))
    return [path, beside]


def _bytes(data: bytes, path: Path) -> list[Path]:
    with atomic_file(path) as file:
        file.write(data)
    return [path]


FORMATS: Mapping[str, Callable[[SonarMap, Path, Heights], list[Path]]] = MappingProxyType(
    {
        ".bt": _bt,
        ".ot": _ot,
        ".ply": _ply,
        ".pcd": _pcd,
        ".xyz": _xyz,
        ".asc": _asc,
        ".pgm": _pgm,
        ".map": _map,
    }
)
"""What a map can be saved as, by suffix."""
