"""`mapperctl convert`: a map's file becomes one of another format, without a daemon."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mapperd.cli.mapperctl.map_output import check_suffix, make_files, origin_among
from mapperd.config.tree import Config
from mapperd.export.calibration import Calibration
from mapperd.export.formats import check_calibration
from mapperd.geometry.geodesy import Origin
from mapperd.store.map_files import map_in

__all__ = ["convert"]


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
