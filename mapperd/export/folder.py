"""The folder of results: map.bt, map.ply, map.png and summary.json."""

import json
from pathlib import Path
from typing import Any

from mapperd.errors import ExportError, MapError
from mapperd.export.atomic import atomic_file
from mapperd.export.picture import can_draw, write_picture
from mapperd.export.ply import write_ply
from mapperd.mapping import SonarMap, Voxels

__all__ = ["write_results"]


def write_results(folder: Path, sonar_map: SonarMap, summary: dict[str, Any]) -> None:
    """Write the map in every form, then the summary; each file is whole or as it was.

    Without matplotlib there is no picture. What the map cannot give is removed from the folder,
    so that no result of an earlier run stands beside the new ones.

    Raises:
        ExportError: a file cannot be written, or the map does not fit into OctoMap's format; the
            other files are there.
    """
    occupied = sonar_map.voxels("occupied")
    with atomic_file(folder / "map.ply") as file:
        write_ply(file, occupied, sonar_map.resolution_m)
    _write_picture(folder / "map.png", occupied, sonar_map.resolution_m, summary)
    with atomic_file(folder / "summary.json") as file:
        file.write(json.dumps(summary, indent=2, allow_nan=False).encode() + b"\n")
    _write_octomap(folder / "map.bt", sonar_map)


def _write_picture(
    path: Path, occupied: Voxels, resolution_m: float, summary: dict[str, Any]
) -> None:
    if not can_draw():
        path.unlink(missing_ok=True)
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
        path.unlink(missing_ok=True)
        raise ExportError(f"{path}: not written: {error}") from error
    with atomic_file(path) as file:
        file.write(tree)
