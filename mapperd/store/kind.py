"""What a stored map is: the settings that its voxels came about by.

None of them may change while the program runs, so that all voxels of a file follow one rule.
"""

import json
import sqlite3
from pathlib import Path
from typing import Any

import msgspec

from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.store.metadata import NAME

__all__ = ["check_kind", "kind_in", "kind_of", "write_kind"]

SECTIONS = ("iwlo", "adaptive")


def kind_of(config: Config) -> dict[str, str]:
    """Settings by their full names, as JSON."""
    facts = {"octree.voxel_resolution": json.dumps(config.octree.voxel_resolution)}
    for section in SECTIONS:
        for name, value in msgspec.to_builtins(getattr(config, section)).items():
            facts[f"{section}.{name}"] = json.dumps(value)
    return facts


def write_kind(connection: sqlite3.Connection, config: Config) -> None:
    """Say in a new file what its map is."""
    connection.executemany("INSERT INTO fact VALUES (?, ?)", kind_of(config).items())


def kind_in(connection: sqlite3.Connection) -> dict[str, Any]:
    """What a file's map is: settings by their full names, such as this program knows.

    Raises:
        ValueError: one of them is not as it was written.
    """
    known = kind_of(Config()).keys()
    told = connection.execute("SELECT name, value FROM fact")
    return {name: json.loads(value) for name, value in told if name in known}


def check_kind(connection: sqlite3.Connection, path: Path, config: Config) -> None:
    """Refuse settings that are not those of the file; such that it does not know are new.

    Raises:
        StoreError: with all that differ.
    """
    ours = kind_of(config)
    differ = [
        f"{name} is {value} in it, {ours.get(name, 'unknown')} in the settings"
        for name, value in connection.execute(
            "SELECT name, value FROM fact WHERE name != ? ORDER BY name", (NAME,)
        )
        if ours.get(name) != value
    ]
    if differ:
        raise StoreError(
            f"{path}: holds a map of other settings: {'; '.join(differ)}. Set them back, or give "
            "another outofcore.map_path",
            "other_parameters",
        )
