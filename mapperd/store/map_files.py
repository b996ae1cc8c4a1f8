"""Reads maps from files of any kind and settings."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mapperd import _core
from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, MapError, os_reason
from mapperd.geometry.geodesy import Origin
from mapperd.mapping.file_headers import settings_of_map, settings_of_octomap
from mapperd.mapping.queries import MapContent
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.position import position_in
from mapperd.store.reader import StoreReader
from mapperd.store.stored_map import StoredMap

__all__ = ["SourcedMap", "holds_map", "map_in"]

SQLITE = b"SQLite format 3\0"
OCTOMAP = b"# Octomap OcTree"

HEADER_BYTES = 4096

MAX_NAMED = 5
"""Sessions in the text for people."""

UNFINISHED = "a daemon maps it now, or the next start maps the rest"


@dataclass(frozen=True, slots=True, eq=False)
class SourcedMap:
    """A map read from a file.

    Attributes:
        map: the map with the settings that it was made with; the caller closes it.
        origin: geographic position of the map's origin, if the file has one.
        bricks_lost: damaged bricks, whose space is unknown in the map.
        has_checksum: False if a daemon's file is of version 1, whose settings cannot be verified.
        incomplete: reasons by session of which the map lacks a part.
        unrecorded: sessions of which a part is in the map only, not in the recordings.
    """

    map: MapContent
    origin: Origin | None
    bricks_lost: int = 0
    has_checksum: bool = True
    incomplete: Mapping[str, str] = field(default_factory=dict)
    unrecorded: tuple[str, ...] = ()

    def remarks(self) -> str:
        """State for people which sessions are incomplete; empty if none is."""
        named = [f"session {one} is incomplete: {why}" for one, why in self.incomplete.items()]
        if len(named) > MAX_NAMED:
            named[MAX_NAMED:] = [f"and {len(named) - MAX_NAMED} more sessions"]
        if self.unrecorded:
            more = ", …" if len(self.unrecorded) > MAX_NAMED else ""
            listed = ", ".join(self.unrecorded[:MAX_NAMED])
            named.append(f"a part of these sessions is in no recording: {listed}{more}")
        return "; ".join(named)


def map_in(
    path: Path,
    config: Config,
    values: Mapping[str, Any] = MappingProxyType({}),
    *,
    allow_damaged: bool = False,
) -> SourcedMap:
    """Read a map: a daemon's file, a `.map`, or a tree of OctoMap, recognized by content.

    Args:
        path: the file.
        config: settings that the file does not contain.
        values: further settings, by name.
        allow_damaged: read the rest of a daemon's file with damaged bricks.

    Raises:
        MapError: it cannot be read, or is not a complete map.
        StoreError: it cannot be read, or is of a later version.
        ConfigError: the values are not allowed.
    """
    begin = _beginning(path)
    if begin.startswith(SQLITE):
        return _stored(path, config, values, allow_damaged=allow_damaged)
    if begin.startswith(_core.MAP_FILE_MAGIC):
        stated = _stated(path, begin, settings_of_map)
        sonar_map = SonarMap(_settings(path, config, stated, values))
        sonar_map.load(path)
        return SourcedMap(sonar_map, None)
    if begin.startswith(OCTOMAP):
        stated = _stated(path, begin, settings_of_octomap)
        sonar_map = SonarMap(_settings(path, config, stated, values))
        try:
            sonar_map.load_octomap(path.read_bytes())
        except MapError as error:
            raise MapError(f"{path}: {error}", error.reason) from error
        return SourcedMap(sonar_map, None)
    raise MapError(
        f"{path}: no map: neither a daemon's file, nor a .map, nor a tree of OctoMap",
        "bad_map_file",
    )


def holds_map(path: Path) -> bool:
    """Return whether a file starts like a map; False if it cannot be read."""
    try:
        return _beginning(path).startswith((SQLITE, _core.MAP_FILE_MAGIC, OCTOMAP))
    except MapError:
        return False


def _beginning(path: Path) -> bytes:
    try:
        if not path.is_file():  # a pipe would block
            raise MapError(f"{path}: there is no such file", "unreadable")
        with path.open("rb") as file:
            return file.read(HEADER_BYTES)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {os_reason(error)}", "unreadable") from error


def _settings(
    path: Path, config: Config, stored: Mapping[str, Any], values: Mapping[str, Any]
) -> Config:
    try:
        of_file = with_values(config, stored)
    except ConfigError as error:
        raise MapError(f"{path}: is of settings that cannot be: {error}", "bad_map_file") from error
    return with_values(of_file, values)


def _stored(
    path: Path, config: Config, values: Mapping[str, Any], *, allow_damaged: bool
) -> SourcedMap:
    with StoreReader(path) as reader:
        kind = reader.kind()
    stored = StoredMap(path, _settings(path, config, kind, values))
    lost = stored.bricks_lost
    if lost and not allow_damaged:
        stored.close()
        raise MapError(
            f"{path}: {lost} bricks of it are damaged; holes would look like water", "bricks_lost"
        )
    position = position_in(stored.position)
    if position is None:
        return SourcedMap(stored, None, lost, stored.has_checksum)
    origin = None if position.origin_deg is None else Origin.of_degrees(*position.origin_deg)
    incomplete = position.incomplete
    if not position.states_all:
        incomplete = {**incomplete, position.session: UNFINISHED}
    return SourcedMap(stored, origin, lost, stored.has_checksum, incomplete, position.unrecorded)


def _stated(
    path: Path, begin: bytes, settings_of: Callable[[bytes], dict[str, Any]]
) -> dict[str, Any]:
    try:
        return settings_of(begin)
    except MapError as error:
        raise MapError(f"{path}: {error}", error.reason) from error
