"""The commands of `mapperctl` that make files without a daemon."""

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mapperd.cli.mapperctl.bag import bag_of_map, bag_of_recordings
from mapperd.cli.mapperctl.errors import CtlError, Exit, plain
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
) -> Iterator[str]:
    """Read a map and write it; yields what there is to say.

    Args:
        source: as `map_in` takes it.
        path: of the new file; its suffix says the format.
        config: thresholds and heights.
        values: settings above these.
        origin: where the map's zero lies on Earth, whatever the file says.
        calibration: of the probabilities; None leaves them as they are.

    Raises:
        MapperdError: what is wrong with the map, the settings or the new file.
    """
    check_suffix(path)
    check_calibration(path, calibration)
    found = map_in(source, config, values)
    counts = found.map.counts()
    edge_m = found.map.resolution_m
    yield f"{source}: {counts.occupied} occupied, {counts.free} free voxels of {edge_m:g} m"
    place = origin_among(origin, found.origin, config)
    yield from make_files(found.map, path, place, calibration).lines()


def run(said: argparse.Namespace, config: Config) -> Iterator[str]:
    """Do a command; yields what there is to print, as it comes.

    Args:
        said: the arguments.
        config: the settings.

    Raises:
        CtlError: it is not done.
        ConfigError: the settings do not allow it.
    """
    try:
        for line in _COMMANDS[said.command](said, config):
            yield plain(line)
    except ExportError as error:
        raise CtlError(str(error), Exit.CANNOT_WRITE) from error
    except (ConfigError, CtlError):
        raise
    except (MapperdError, OculusError) as error:
        raise CtlError(str(error), Exit.USAGE) from error


def _convert(said: argparse.Namespace, config: Config) -> Iterator[str]:
    curve = None if said.calibration is None else load_calibration(said.calibration)
    values = _values(said, config)
    return convert(said.source, said.file, config, values, _origin(said), calibration=curve)


def _bag(said: argparse.Namespace, config: Config) -> Iterator[str]:
    if said.as_recorded and (said.pose or said.config or said.min_probability):
        raise CtlError(
            "--as-recorded leaves no room for --config, --pose and --min-probability", Exit.USAGE
        )
    values = _values(said, config)
    if holds_map(said.source):
        return bag_of_map(said.source, said.bag, config, values, said.storage)
    return bag_of_recordings(
        said.source,
        said.bag,
        None if said.as_recorded else config,
        values,
        pose=None if said.pose is None else pose_from_rpy(said.pose[:3], said.pose[3:]),
        every_s=said.every,
        storage=said.storage,
    )


def _values(said: argparse.Namespace, config: Config) -> dict[str, Any]:
    """Settings that the arguments stand for."""
    least = said.min_probability
    if least is None:
        return {}
    free = min(config.mapping.free_threshold, least)
    return {"mapping.occupied_threshold": least, "mapping.free_threshold": free}


def _origin(said: argparse.Namespace) -> Origin | None:
    return None if said.origin is None else Origin.of_degrees(*said.origin)


_COMMANDS: Mapping[str, Callable[[argparse.Namespace, Config], Iterator[str]]] = MappingProxyType(
    {"bag": _bag, "convert": _convert}
)
