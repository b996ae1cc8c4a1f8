"""`mapperctl diff`: compare two map files."""

import json
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from mapperd.cli.mapperctl.map_output import missing
from mapperd.config.tree import Config
from mapperd.errors import ExportError
from mapperd.export.clouds import write_difference
from mapperd.io import atomic_file
from mapperd.mapping.difference import MapDifference, OneWayDifference, compare_maps
from mapperd.store.map_files import map_in

__all__ = ["diff"]


def diff(
    first: Path,
    second: Path,
    config: Config,
    values: Mapping[str, Any],
    *,
    tolerance_m: float | None = None,
    cloud: Path | None = None,
    as_json: bool = False,
    allow_damaged: bool = False,
) -> Iterator[str]:
    """Compare two maps; yield the lines to print.

    Args:
        first: the earlier map, as in `map_in`.
        second: the later map, in the same frame.
        config: thresholds.
        values: settings that override `config`.
        tolerance_m: as of `compare_maps`.
        cloud: PLY file to write; None writes none.
        as_json: yield one JSON object.
        allow_damaged: compare what is left of maps with damaged bricks.

    Raises:
        MapperdError: a map, the tolerance or the cloud is invalid.
    """
    if cloud is not None and cloud.suffix != ".ply":
        raise ExportError(f"{cloud.name}: unknown format; the cloud is a .ply")
    a = map_in(first, config, values, allow_damaged=allow_damaged)
    with closing(a.map):
        b = map_in(second, config, values, allow_damaged=allow_damaged)
        with closing(b.map):
            found = compare_maps(a.map, b.map, tolerance_m)
            edges_m = a.map.resolution_m, b.map.resolution_m
    if cloud is not None:
        with atomic_file(cloud) as file:
            write_difference(file, found)
    lost = a.bricks_lost + b.bricks_lost
    if as_json:
        yield json.dumps(_plain(found, (first, second), edges_m, lost))
        return
    yield from _lines(found, (first, second), edges_m)
    if lost:
        yield missing(lost)
    if cloud is not None:
        yield f"{cloud}: {cloud.stat().st_size} bytes"


def _lines(
    found: MapDifference, paths: tuple[Path, Path], edges_m: tuple[float, float]
) -> Iterator[str]:
    a, b = found.vanished, found.appeared
    for letter, path, way, edge_m in zip("AB", paths, (a, b), edges_m, strict=True):
        yield f"{letter} {path}: {len(way.same)} occupied voxels of {edge_m:g} m"
    yield f"same      {_share(b.same)} of B within {found.tolerance_m:g} m"
    yield f"appeared  {_share(b.changed)} of B where A had observed the place"
    yield f"vanished  {_share(a.changed)} of A where B has observed the place"
    yield f"not seen  {_share(~b.seen)} of B by A, {_share(~a.seen)} of A by B"
    for name, way in (("A to B", a), ("B to A", b)):
        median, p95 = (_metres(way.quantile_m(share), found.reach_m) for share in (0.5, 0.95))
        yield f"{name}    median {median}, 95 % within {p95}, where both observed"


def _share(which: Any) -> str:  # noqa: ANN401 an array of bools
    return f"{int(np.sum(which))} ({np.mean(which) if len(which) else 0.0:.1%})"


def _metres(value: float | None, reach_m: float) -> str:
    return f"> {reach_m:g} m" if value is None else f"{value:.3g} m"


def _plain(
    found: MapDifference, paths: tuple[Path, Path], edges_m: tuple[float, float], lost: int
) -> dict[str, Any]:
    a, b = found.vanished, found.appeared
    return {
        "tolerance_m": found.tolerance_m,
        "grid_m": found.grid_m,
        "reach_m": found.reach_m,
        "bricks_lost": lost,
        "a": _side(a, paths[0], edges_m[0]) | {"vanished": int(a.changed.sum())},
        "b": _side(b, paths[1], edges_m[1]) | {"appeared": int(b.changed.sum())},
    }


def _side(way: OneWayDifference, path: Path, edge_m: float) -> dict[str, Any]:
    near = way.distance_m[way.seen & np.isfinite(way.distance_m)]
    return {
        "path": str(path),
        "resolution_m": edge_m,
        "occupied": len(way.same),
        "same": int(way.same.sum()),
        "not_seen_by_other": int((~way.seen).sum()),
        "distance_m": {
            "mean_within_reach": float(near.mean()) if len(near) else None,
            "median": way.quantile_m(0.5),
            "p95": way.quantile_m(0.95),
        },
    }
