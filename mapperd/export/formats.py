"""A map as a file, in the format that the file's name asks for."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np

from mapperd.errors import ExportError
from mapperd.export.calibration import ProbabilityCalibration
from mapperd.export.cells import NO_TOP, GridLayer, GridWindow, Heights, Tops, known_cells
from mapperd.export.clouds import write_pcd, write_ply, write_xyz
from mapperd.export.geotiff import write_geotiff, write_las
from mapperd.geometry.geodesy import Origin, local_projection, utm_zone
from mapperd.io import atomic_file
from mapperd.mapping.queries import MapContent, VoxelCloud
from mapperd.mapping.sonar_map import SonarMap

__all__ = [
    "FORMATS",
    "FREE_THRESH",
    "GREY",
    "NO_DATA",
    "OCCUPIED_THRESH",
    "PROBABILITY_FORMATS",
    "check_calibration",
    "crs_of",
    "nav2_yaml",
    "write_ascii_grid",
    "write_map",
    "write_pgm",
]

ALL = Heights()


@dataclass(frozen=True, slots=True)
class _FormatOptions:
    heights: Heights
    origin: Origin | None
    calibration: ProbabilityCalibration | None

    def occupied(self, sonar_map: MapContent) -> VoxelCloud:
        """The occupied voxels, with the probabilities that are asked for."""
        voxels = sonar_map.occupied()
        return voxels if self.calibration is None else self.calibration.of(voxels)


def write_map(
    sonar_map: MapContent,
    path: Path,
    heights: Heights = ALL,
    origin: Origin | None = None,
    calibration: ProbabilityCalibration | None = None,
) -> list[Path]:
    """Write one state of a map, whole or not at all, while pings may still change it.

    Args:
        sonar_map: in memory as a whole, or read from its file.
        path: its suffix is one of `FORMATS`.
        heights: what the flat formats, `.asc`, `.tif` and `.pgm`, look at.
        origin: geographic position of the map's origin; None if unknown.
        calibration: calibration of probabilities in `PROBABILITY_FORMATS`, if any.

    Returns:
        the files: `.pgm` has a `.yaml` beside it.

    Raises:
        ExportError: the suffix is no format, the library for it is not installed, the file cannot
            be written, the format cannot hold this map, or it takes no calibration.
        MapError: the map is in tiles (`in_tiles`), or leaves OctoMap's reach (`out_of_reach`).
    """
    write = FORMATS.get(path.suffix)
    if write is None:
        raise ExportError(f"{path.name}: unknown format; known suffixes: {' '.join(FORMATS)}")
    check_calibration(path, calibration)
    if isinstance(sonar_map, SonarMap):
        sonar_map.check_whole()
    return write(sonar_map, path, _FormatOptions(heights, origin, calibration))


def check_calibration(path: Path, calibration: ProbabilityCalibration | None) -> None:
    """Refuse a calibration where there is no probability to change.

    Files that are a map again when they are read, OctoMap's and our own, keep the map's log-odds.

    Raises:
        ExportError: it is one.
    """
    if calibration is not None and path.suffix not in PROBABILITY_FORMATS:
        raise ExportError(
            f"{path.name}: {path.suffix} takes no calibration; those that do: "
            f"{' '.join(PROBABILITY_FORMATS)}"
        )


def crs_of(path: Path, origin: Origin | None) -> str | None:
    """Coordinate reference system of a file as text; None for formats without one."""
    projection = _PROJECTIONS.get(path.suffix)
    if projection is None:
        return None
    if origin is None:
        return "none: the geographic position of the map is unknown"
    found = projection(origin)
    return f"{found.name}, EPSG:{found.epsg}" if found.epsg else found.name


_PROJECTIONS = MappingProxyType({".las": utm_zone, ".laz": utm_zone, ".tif": local_projection})


def _map(sonar_map: MapContent, path: Path, _: _FormatOptions) -> list[Path]:
    sonar_map.save(path)
    return [path]


def _octomap(sonar_map: MapContent, path: Path, _: _FormatOptions) -> list[Path]:
    sonar_map.save_octomap(path)
    return [path]


def _ply(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    occupied = asked.occupied(sonar_map)
    with atomic_file(path) as file:
        write_ply(file, occupied, sonar_map.resolution_m)
    return [path]


def _pcd(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    occupied = asked.occupied(sonar_map)
    with atomic_file(path) as file:
        write_pcd(file, occupied, sonar_map.resolution_m)
    return [path]


def _xyz(sonar_map: MapContent, path: Path, _: _FormatOptions) -> list[Path]:
    occupied = sonar_map.occupied()
    with atomic_file(path) as file:
        write_xyz(file, occupied)
    return [path]


def _asc(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    tops = Tops(sonar_map, asked.heights)
    with atomic_file(path) as file:
        write_ascii_grid(file, tops, sonar_map.resolution_m)
    return [path]


def _las(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    occupied = asked.occupied(sonar_map)
    with atomic_file(path) as file:
        write_las(file, occupied, asked.origin, packed=path.suffix == ".laz")
    return [path]


def _tif(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    tops = Tops(sonar_map, asked.heights)
    with atomic_file(path) as file:
        write_geotiff(file, tops, sonar_map.resolution_m, asked.origin)
    return [path]


def _pgm(sonar_map: MapContent, path: Path, asked: _FormatOptions) -> list[Path]:
    """Both files are written before either takes its place."""
    cells = known_cells(sonar_map, asked.heights)
    beside = path.with_suffix(".yaml")
    with atomic_file(beside) as text, atomic_file(path) as picture:
        write_pgm(picture, cells)
        if cells is not None:
            text.write(nav2_yaml(path.name, cells, sonar_map.resolution_m))
    return [path, beside]


PROBABILITY_FORMATS = (".ply", ".pcd", ".las", ".laz")
"""Formats with a probability per voxel that are not read back as maps."""

FORMATS: Mapping[str, Callable[[MapContent, Path, _FormatOptions], list[Path]]] = MappingProxyType(
    {
        ".bt": _octomap,
        ".ot": _octomap,
        ".ply": _ply,
        ".pcd": _pcd,
        ".xyz": _xyz,
        ".las": _las,
        ".laz": _las,
        ".asc": _asc,
        ".tif": _tif,
        ".pgm": _pgm,
        ".map": _map,
    }
)
"""What a map can be saved as, by suffix."""


NO_DATA = "-9999"

ROWS_AT_ONCE = 256
"""Rows of a picture that are made at a time."""


def write_ascii_grid(file: BinaryIO, tops: Tops, resolution_m: float) -> None:
    """Write elevations in metres: z up, not a depth, of the centre of each column's top voxel.

    The format has no place for units, axes or a name of the frame: x is east and y north, in
    metres from the map's origin.

    Args:
        file: where to.
        tops: highest occupied voxels.
        resolution_m: edge of a cell.

    Raises:
        ExportError: there is nothing to write; the format knows no empty grid.
    """
    if tops.window is None:
        raise ExportError("no occupied voxel: there is no surface to write")
    file.write(_header(tops.window, resolution_m).encode("ascii"))
    for strip in tops.strips(1):
        for row in strip.z:  # the first line is the north
            known = row != NO_TOP
            words = np.full(len(row), NO_DATA, dtype=object)
            words[known] = [f"{z:.4f}" for z in ((row[known] + 0.5) * resolution_m).tolist()]
            file.write((" ".join(words.tolist()) + "\n").encode("ascii"))


def _header(window: GridWindow, resolution_m: float) -> str:
    lines = [
        f"ncols {window.width}",
        f"nrows {window.height}",
        f"xllcorner {window.x * resolution_m:.10g}",
        f"yllcorner {window.y * resolution_m:.10g}",
        f"cellsize {resolution_m:.10g}",
        f"NODATA_value {NO_DATA}",
        "",
    ]
    return "\n".join(lines)


GREY = np.array([205, 254, 0], dtype=np.uint8)
"""Of unknown, free and occupied cells, as map servers write them."""

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""A pixel p is read as occupied above the one in (255 - p) / 255, as free below the other.

The often seen 0.25 would make 205, which is 0.19608, free.
"""


def write_pgm(file: BinaryIO, cells: GridLayer | None) -> None:
    """Write the picture, north on top.

    Raises:
        ExportError: nothing is known; the format has no empty picture.
    """
    if cells is None:
        raise ExportError("nothing is known at these heights: there is no grid to write")
    window = cells.window
    file.write(f"P5\n{window.width} {window.height}\n255\n".encode("ascii"))
    from_north = cells.values[::-1]
    file.writelines(
        GREY[from_north[row : row + ROWS_AT_ONCE]].tobytes()
        for row in range(0, window.height, ROWS_AT_ONCE)
    )


def nav2_yaml(image: str, cells: GridLayer, resolution_m: float) -> bytes:
    """The text beside it; its origin is the picture's lower left corner in the map's frame."""
    window = cells.window
    corner = f"{window.x * resolution_m:.10g}, {window.y * resolution_m:.10g}, 0"
    lines = [
        f"image: {json.dumps(image, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {resolution_m:.10g}",
        f"origin: [{corner}]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESH}",
        f"free_thresh: {FREE_THRESH}",
        "",
    ]
    return "\n".join(lines).encode()
