"""Commands of `mapperctl` that write files without a daemon."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mapperd.cli.mapperctl.bag import bag_of_map, bag_of_recordings
from mapperd.cli.mapperctl.diff import diff
from mapperd.cli.mapperctl.errors import CtlError, CtlExit, plain
from mapperd.cli.mapperctl.map_output import check_suffix, make_files, origin_among
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError, MapperdError
from mapperd.export.calibration import Calibration, load_calibration
from mapperd.export.formats import check_calibration
from mapperd.geometry.frames import pose_from_rpy
from mapperd.geometry.geodesy import Origin
from mapperd.store.map_files import holds_map, map_in
from oculus_driver.errors import OculusError

__all__ = ["convert", "run"]


def convert(
    source: Path,
    path: Path,
    config: Config,
    values: Mapping[str, Any],
    origin: Origin | None,
    *,
    calibration: Calibration | None = None,
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
    except ExportError as error:
        raise CtlError(str(error), CtlExit.CANNOT_WRITE) from error
    except (ConfigError, CtlError):
        raise
    except (MapperdError, OculusError) as error:
        raise CtlError(str(error), CtlExit.USAGE) from error


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
            "--as-recorded excludes --config, --pose and --min-probability", CtlExit.USAGE
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
    return diff(
        args.first,
        args.second,
        config,
        _values(args, config),
        tolerance_m=args.tolerance,
        cloud=args.out,
        as_json=args.json,
        allow_damaged=args.allow_damaged,
    )


def _values(args: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Settings from the arguments."""
    min_probability = args.min_probability
    if min_probability is None:
        return {}
    free = min(config.mapping.free_threshold, min_probability)
    return {"mapping.occupied_threshold": min_probability, "mapping.free_threshold": free}


def _origin(args: argparse.Namespace) -> Origin | None:
    return None if args.origin is None else Origin.of_degrees(*args.origin)


_COMMANDS: Mapping[str, Callable[[argparse.Namespace, Config], Iterator[str]]] = MappingProxyType(
    {"bag": _bag, "convert": _convert, "diff": _diff}
)
