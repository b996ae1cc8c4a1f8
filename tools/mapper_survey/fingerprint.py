"""Fingerprints of the inputs of results; equal fingerprints mean equal results."""

import functools
import hashlib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

import msgspec

from mapperd.config.tree import Config
from mapperd.localization.map_io import image_of
from mapperd.odometry.odometry_files import content_files
from mapperd.session.recordings import files_in

__all__ = ["digest_of", "facts_of", "known_map_facts", "program_digest"]

PACKAGES = ("mapperd", "oculus_driver", "mapper_survey")
CORE = "mapperd._core"


def digest_of(*parts: bytes | str | Config) -> str:
    """Return the fingerprint of values in order."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, Config):
            data = msgspec.json.encode(part, order="deterministic")
        else:
            data = part if isinstance(part, bytes) else part.encode()
        digest.update(len(data).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:24]


def facts_of(*paths: Path) -> str:
    """Return names, sizes and modification times of recordings or odometry files."""
    return "\n".join(_fact(path) for path in content_files(files_in(paths)))


def known_map_facts(path: Path) -> str:
    """Return the fingerprint of a known map with the files that belong to it.

    Raises:
        MapError: it is a planar map with an invalid description.
    """
    return "\n".join(_fact(each) for each in _files_of_map(path))


def _files_of_map(path: Path) -> list[Path]:
    """Return its image, or the journal with a daemon's last writes.

    An empty journal does not count, because reading the map may leave one.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return [path, path.parent / image_of(path)]
    journal = path.with_name(f"{path.name}-wal")
    written = journal.is_file() and journal.stat().st_size > 0
    return [path, journal] if written else [path]


def _fact(path: Path) -> str:
    try:
        status = path.stat()
    except OSError as error:
        return f"{path.name} {error.strerror}"
    return f"{path.name} {status.st_size} {status.st_mtime_ns}"


@functools.cache
def program_digest() -> str:
    """Return the fingerprint of the program's files: a new version makes everything again."""
    digest = hashlib.sha256()
    for path in _program_files():
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:24]


def _program_files() -> Iterable[Path]:
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        assert spec is not None  # noqa: S101 this file is of one of them
        for place in spec.submodule_search_locations or []:
            yield from sorted(Path(place).rglob("*.py"))
    core = importlib.util.find_spec(CORE)
    assert core is not None  # noqa: S101 nothing works without it
    assert core.origin is not None  # noqa: S101 it is a file
    yield Path(core.origin)
