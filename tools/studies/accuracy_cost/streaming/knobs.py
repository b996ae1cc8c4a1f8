"""What is turned in the study of the map stream."""

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
from studies.accuracy_cost.study import Knob, Setting, Value

__all__ = ["KNOBS", "WHOLES", "StreamSetting", "constants", "stream_setting"]


@dataclass(frozen=True, slots=True)
class StreamSetting:
    """Settings of the daemon, and what the client asks for.

    Attributes:
        is_plain: as plain floats instead of by the map stream.
        near_m: radius that is sent first.
        compression: level of zstd.
    """

    config: Config
    interest: Interest
    is_plain: bool = False
    near_m: float = priority_queue.NEAR_M
    compression: int = blocks.LEVEL


def stream_setting(overrides: Mapping[str, Value], voxel_m: float) -> StreamSetting:
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
    return StreamSetting(config_of(tree, "study"), msgspec.convert(asked, Interest), **ours)


@contextmanager
def constants(setting: StreamSetting) -> Iterator[None]:
    """Turn what is no setting, for a while."""
    before = priority_queue.NEAR_M, blocks.LEVEL
    priority_queue.NEAR_M, blocks.LEVEL = setting.near_m, setting.compression
    try:
        yield
    finally:
        priority_queue.NEAR_M, blocks.LEVEL = before


MARGIN = 0.1


def _turned(name: str, default: Value, *values: Value) -> tuple[Setting, ...]:
    return tuple(Setting(str(value), {} if value == default else {name: value}) for value in values)


KNOBS = (
    Knob(
        "step",
        "Step of the log-odds (stream.log_odds_step)",
        _turned("stream.log_odds_step", 0.25, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0),
        None,
        MARGIN,
        "The first to turn up on a thin link: changes smaller than a step are not sent.",
        quick=True,
    ),
    Knob(
        "level",
        "Cells that a client asks for: cubes of so many voxels along an edge",
        (
            Setting("1", {}),
            Setting("2", {"client.level": 1}),
            Setting("4", {"client.level": 2}),
            Setting("8", {"client.level": 3}),
        ),
        None,
        MARGIN,
        "A coarse map takes a fraction of the bytes, and thickens walls, as a cell holds the "
        "highest of its voxels.",
        quick=True,
    ),
    Knob(
        "detail",
        "What a client asks for of each cell",
        _turned("client.detail", "log_odds", "classes", "log_odds", "counts"),
        None,
        MARGIN,
        "Classes alone are enough for a picture or a planner that asks for obstacles alone.",
    ),
    Knob(
        "rate",
        "Looks for changes a second (stream.rate), of 5 pings a second",
        _turned("stream.rate", 5.0, 0.5, 1.0, 2.0, 5.0, 10.0),
        None,
        MARGIN,
        "Fewer updates send a cell once that changed several times, and later.",
    ),
    Knob(
        "budget",
        "Bytes a second that a client is sent at most (0: what the link carries)",
        _turned("stream.bytes_per_s", 0, 2000, 4000, 8000, 16000, 64000, 0),
        None,
        MARGIN,
        "What the link carries is found out by itself; a budget leaves room for others.",
    ),
    Knob(
        "near",
        "Radius that is sent first, metres",
        _turned("study.near_m", 13.0, 3.0, 8.0, 13.0, 20.0, 40.0),
        None,
        MARGIN,
        "No setting: what is sent first where a link is full.",
    ),
    Knob(
        "radius",
        "Radius that a client asks for, metres (0: the whole map)",
        _turned("client.radius_m", 0.0, 0.0, 5.0, 10.0, 15.0),
        None,
        MARGIN,
        "A client that steers asks for what is near alone.",
    ),
    Knob(
        "compression",
        "Level of zstd",
        _turned("study.compression", 9, 1, 3, 6, 9, 12, 19),
        None,
        MARGIN,
        "No setting: time of the daemon against bytes, once for all clients that keep up.",
    ),
)

WHOLES = (Setting("plain floats", {"study.plain": True}),)
