"""The folder of results: map.bt, map.ply, map.png and summary.json."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from mapperd.errors import ExportError, MapError
from mapperd.export.clouds import write_ply
from mapperd.export.picture import can_draw, write_picture
from mapperd.io import atomic_file, remove
from mapperd.mapping.sonar_map import SonarMap, Voxels

__all__ = ["write_results"]


def write_results(folder: Path, sonar_map: SonarMap, summary: dict[str, Any]) -> None:
    """Write the summary, then the map in every form; each file is whole or as it was.

    Without matplotlib there is no picture. What the map cannot give is removed from the folder,
    so that no result of an earlier run stands beside the new ones.

    Raises:
        ExportError: files cannot be written, or the map does not fit into OctoMap's format; the
            other files are there.
    """
    occupied = sonar_map.voxels("occupied")
    resolution_m = sonar_map.resolution_m
    problems = [
        *_problem(partial(_write_summary, folder / "summary.json", summary)),
        *_problem(partial(_write_octomap, folder / "map.bt", sonar_map)),
        *_problem(partial(_write_cloud, folder / "map.ply", occupied, resolution_m)),
        *_problem(partial(_write_picture, folder / "map.png", occupied, resolution_m, summary)),
    ]
    if problems:
        raise ExportError("; ".join(problems))


def _problem(write: Callable[[], None]) -> list[str]:
    """Write one file; returns why not, if not: the others are written all the same."""
    try:
        write()
    except ExportError as error:
        return [str(error)]
    return []


def _write_summary(path: Path, summary: dict[str, Any]) -> None:
    with atomic_file(path) as file:
        file.write(json.dumps(summary, indent=2, allow_nan=False).encode() + b"\n")


def _write_cloud(path: Path, occupied: Voxels, resolution_m: float) -> None:
    with atomic_file(path) as file:
        write_ply(file, occupied, resolution_m)


def _write_picture(
    path: Path, occupied: Voxels, resolution_m: float, summary: dict[str, Any]
) -> None:
    if not can_draw():
        remove(path)
        return
    title = (
        f"{len(occupied)} occupied voxels of {resolution_m:g} m from "
        f"{summary['pings_mapped']} of {summary['pings_total']} pings"
    )
    with atomic_file(path) as file:
        write_picture(file, occupied, resolution_m, title)


def _write_octomap(path: Path, sonar_map: SonarMap) -> None:
    try:
        tree = sonar_map.octomap_bt()
    except MapError as error:
        remove(path)
        raise ExportError(f"{path}: not written: {error}") from error
    with atomic_file(path) as file:
        file.write(tree)
