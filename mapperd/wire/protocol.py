"""What both ends of the map stream agree on: limits, the head of a message, what is told of."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = [
    "BLOCK_EDGE",
    "MAX_BLOCKS",
    "MAX_FROM_CLIENT",
    "MAX_FROM_SERVER",
    "MAX_LEVEL",
    "MAX_PATH",
    "MAX_SETTINGS",
    "VERSION",
    "WANTS",
    "Box",
    "Count",
    "Interest",
    "Message",
    "Name",
    "Quaternion",
    "Vector",
    "Want",
]

VERSION = 1
BLOCK_EDGE = 8
"""Cells along one edge of a block of the stream."""

MAX_LEVEL = 3
"""Cells of level n are cubes of 2**n voxels along an edge."""

MAX_BLOCKS = 2048
"""In one message."""

MAX_FROM_SERVER = 4 << 20
"""Bytes of a message, its length not counted."""

MAX_FROM_CLIENT = 64 << 10

MAX_PATH = 100_000
"""Points of a path, all pieces together."""

MAX_SETTINGS = 10_000

Want = Literal[
    "map",
    "pose",
    "path",
    "fan",
    "returns",
    "image",
    "robots",
    "localization",
    "status",
    "events",
    "settings",
]
WANTS: tuple[Want, ...] = Want.__args__  # type: ignore[attr-defined]

Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Name = Annotated[str, Meta(max_length=100)]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Message(Struct, frozen=True, kw_only=True, tag_field="t", tag=str.lower, omit_defaults=True):
    """Unknown keys are passed over, so that a later version may say more."""


class Box(Struct, frozen=True, forbid_unknown_fields=True):
    """A box with its edges along the map's axes."""

    low_m: Vector
    high_m: Vector


class Interest(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Which part of the map a client is told of, and how finely.

    Attributes:
        level: cells are cubes of 2**level voxels.
        detail: `classes` tells unknown, free and occupied alone; `log_odds` their quantised
            log-odds too, `counts` also how often cells were observed.
        radius_m: around the vehicle; 0 has no limit.
        box: and inside this; None has no limit.
    """

    level: Annotated[int, Meta(ge=0, le=MAX_LEVEL)] = 0
    detail: Literal["classes", "log_odds", "counts"] = "log_odds"
    radius_m: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    box: Box | None = None
