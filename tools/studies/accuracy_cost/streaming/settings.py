"""How a client is told of the map."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import msgspec

from mapperd.config.loader import config_of
from mapperd.config.tree import Config
from mapperd.server import priority_queue
from mapperd.wire import blocks
from mapperd.wire.messages import Interest
from studies.accuracy_cost.study import Value

__all__ = ["Told", "constants", "told_by"]


@dataclass(frozen=True, slots=True)
class Told:
    """Settings of the daemon, and what the client asks for.

    Attributes:
        is_plain: as plain floats instead of by the map stream.
        near_m: what is told first.
        compression: level of zstd.
    """

    config: Config
    interest: Interest
    is_plain: bool = False
    near_m: float = priority_queue.NEAR_M
    compression: int = blocks.LEVEL


def told_by(overrides: Mapping[str, Value], voxel_m: float) -> Told:
    """The defaults, with some settings turned.

    `stream.*` are settings of the daemon, `client.*` fields of a client's interest; `study.plain`,
    `study.near_m` and `study.compression` are what neither of them may choose.

    Raises:
        ConfigError, ValidationError: no such setting, or a value that it does not take.
        ValueError: no such word of the study's own.
    """
    tree: dict[str, dict[str, Any]] = {"octree": {"voxel_resolution": voxel_m}}
    asked: dict[str, Any] = {}
    ours: dict[str, Any] = {}
    for name, value in overrides.items():
        section, field = name.split(".")
        if section == "client":
            asked[field] = value
        elif section == "study":
            ours["is_plain" if field == "plain" else field] = value
        else:
            tree.setdefault(section, {})[field] = value
    if not {*ours} <= {"is_plain", "near_m", "compression"}:
        raise ValueError(f"{', '.join(ours)}: allowed are plain, near_m and compression")
    return Told(config_of(tree, "study"), msgspec.convert(asked, Interest), **ours)


@contextmanager
def constants(told: Told) -> Iterator[None]:
    """Turn what is no setting, for a while."""
    before = priority_queue.NEAR_M, blocks.LEVEL
    priority_queue.NEAR_M, blocks.LEVEL = told.near_m, told.compression
    try:
        yield
    finally:
        priority_queue.NEAR_M, blocks.LEVEL = before
