"""Commands of `mapperctl` that read and write files without a daemon."""

import argparse
import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mapperd.cli.mapperctl.bag import bag_of_map, bag_of_recordings
from mapperd.cli.mapperctl.connection import CtlError, file_error_code, plain
from mapperd.cli.mapperctl.map_output import (
    check_suffix,
    make_files,
    missing,
    origin_among,
    remarks_on,
)
from mapperd.config.live import occupied_above
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError, MapperdError
from mapperd.export.calibration import ProbabilityCalibration, load_calibration
from mapperd.export.clouds import write_difference
from mapperd.export.formats import check_calibration
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.geodesy import Origin
from mapperd.io import atomic_file
from mapperd.mapping.difference import (
    MapChange,
    MapDifference,
    OneWayDifference,
    changes_of,
    compare_maps,
)
from mapperd.store.map_files import holds_map, map_in
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import OculusError

__all__ = ["convert", "diff_maps", "run"]

MAX_CHANGES = 20
"""Changes that are listed; JSON has them all."""


def convert(
    source: Path,
    path: Path,
    config: Config,
    values: Mapping[str, Any],
    origin: Origin | None,
    *,
    calibration: ProbabilityCalibration | None = None,
    allow_damaged: bool = False,
) -> Iterator[str]:
    """Convert a map file; yield the lines to print.

    Args:
        source: as in `map_in`.
        path: new file; its suffix selects the format.
        config: thresholds and heights.
        values: settings that override `config`.
        origin: geographic position of the map's origin; overrides the file's.
        calibration: calibration of the probabilities, if any.
        allow_damaged: convert what is left of a map with damaged bricks.

    Raises:
        MapperdError: the map, the settings or the new file are invalid.
    """
    check_suffix(path)
    check_calibration(path, calibration)
    found = map_in(source, config, values, allow_damaged=allow_damaged)
    with closing(found.map) as whole:
        counts, edge_m = whole.counts(), whole.resolution_m
        yield f"{source}: {counts.occupied} occupied, {counts.free} free voxels of {edge_m:g} m"
        yield from remarks_on(source, found)
        place = origin_among(origin, found.origin, config)
        made = make_files(whole, path, place, calibration, bricks_lost=found.bricks_lost)
    yield from made.lines()


def run(args: argparse.Namespace, config: Config) -> Iterator[str]:
    """Run a command; yield the lines to print.

    Args:
        args: parsed command line.
        config: settings.

    Raises:
        CtlError: the command failed.
        ConfigError: the settings do not allow it.
    """
    try:
        for line in _COMMANDS[args.command](args, config):
            yield plain(line)
    except (ConfigError, CtlError):
        raise
    except (MapperdError, OculusError) as error:
        raise CtlError(str(error), file_error_code(error)) from error


def _convert(args: argparse.Namespace, config: Config) -> Iterator[str]:
    curve = None if args.calibration is None else load_calibration(args.calibration)
    values = _values(args, config)
    return convert(
        args.source,
        args.file,
        config,
        values,
        _origin(args),
        calibration=curve,
        allow_damaged=args.allow_damaged,
    )


def _bag(args: argparse.Namespace, config: Config) -> Iterator[str]:
    if args.as_recorded and (args.pose or args.config or args.min_probability):
        raise CtlError(
            "--as-recorded excludes --config, --pose and --min-probability", ExitCode.USAGE
        )
    values = _values(args, config)
    if holds_map(args.source):
        return bag_of_map(
            args.source,
            args.bag,
            config,
            values,
            storage=args.storage,
            allow_damaged=args.allow_damaged,
        )
    return bag_of_recordings(
        args.source,
        args.bag,
        None if args.as_recorded else config,
        values,
        pose=None if args.pose is None else pose_from_rpy(args.pose[:3], args.pose[3:]),
        every_s=args.every,
        storage=args.storage,
    )


def _diff(args: argparse.Namespace, config: Config) -> Iterator[str]:
    return diff_maps(
        args.first,
        args.second,
        config,
        _values(args, config),
        tolerance_m=args.tolerance,
        cloud=args.out,
        as_json=args.json,
        allow_damaged=args.allow_damaged,
        min_voxels=args.min_voxels or config.changes.min_voxels,
    )


def diff_maps(
    first: Path,
    second: Path,
    config: Config,
    values: Mapping[str, Any],
    *,
    tolerance_m: float | None = None,
    cloud: Path | None = None,
    as_json: bool = False,
    allow_damaged: bool = False,
    min_voxels: int = 1,
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
        min_voxels: smaller changes are not listed.

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
    changes = changes_of(found, min_voxels)
    if as_json:
        plain_values = _plain(found, (first, second), edges_m, lost)
        for side, source in (("a", a), ("b", b)):
            plain_values[side]["incomplete"] = dict(source.incomplete)
            plain_values[side]["unrecorded"] = list(source.unrecorded)
        plain_values["changes"] = [dataclasses.asdict(one) for one in changes]
        yield json.dumps(plain_values)
        return
    yield from _lines(found, (first, second), edges_m)
    yield from _change_lines(changes)
    for path, source in ((first, a), (second, b)):
        yield from remarks_on(path, source)
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


def _change_lines(changes: Sequence[MapChange]) -> Iterator[str]:
    for change in changes[:MAX_CHANGES]:
        ranges = zip("xyz", change.low_m, change.high_m, strict=True)
        where = ", ".join(f"{axis} {low:.2f} to {high:.2f}" for axis, low, high in ranges)
        yield f"change    {change.kind}, {change.voxels} voxels at {where} m"
    if len(changes) > MAX_CHANGES:
        yield f"change    and {len(changes) - MAX_CHANGES} smaller ones"


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


def _values(args: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Settings from the arguments."""
    min_probability = args.min_probability
    return {} if min_probability is None else occupied_above(config, min_probability)


def _origin(args: argparse.Namespace) -> Origin | None:
    return None if args.origin is None else Origin.of_degrees(*args.origin)


_COMMANDS: Mapping[str, Callable[[argparse.Namespace, Config], Iterator[str]]] = MappingProxyType(
    {"bag": _bag, "convert": _convert, "diff": _diff}
)
