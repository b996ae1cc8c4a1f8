"""Classes that may stand in a checkpoint, and the tags of its values.

A checkpoint names a class by its module and name. Only classes that these modules define are found,
they are made without calling anything of theirs, and get plain attributes: a file cannot make the
program run what is in it.
"""

import sys
from collections.abc import Iterator
from dataclasses import is_dataclass
from enum import Enum, StrEnum
from typing import Any

from msgspec import Struct

from mapperd.errors import CheckpointError

__all__ = ["FORMAT", "Tag", "attributes_of", "class_named", "is_frozen", "kept_of", "name_of"]

MODULES = (
    "mapperd.config.daemon",
    "mapperd.config.filters",
    "mapperd.config.odometry",
    "mapperd.config.tree",
    "mapperd.errors",
    "mapperd.geometry.frames",
    "mapperd.geometry.gaussian",
    "mapperd.geometry.geodesy",
    "mapperd.imaging.robots",
    "mapperd.localization.burst_filter",
    "mapperd.localization.hypothesis",
    "mapperd.localization.lifecycle",
    "mapperd.localization.localizer",
    "mapperd.localization.map_filter",
    "mapperd.localization.odom_correction",
    "mapperd.localization.particle_filter",
    "mapperd.localization.scan",
    "mapperd.localization.stage",
    "mapperd.localization.update_gate",
    "mapperd.odometry.bridge",
    "mapperd.odometry.clock",
    "mapperd.odometry.decoder",
    "mapperd.odometry.fusion",
    "mapperd.odometry.gate",
    "mapperd.odometry.intake",
    "mapperd.odometry.levelling",
    "mapperd.odometry.mavlink",
    "mapperd.odometry.native",
    "mapperd.odometry.nmea",
    "mapperd.odometry.reckoning",
    "mapperd.odometry.records",
    "mapperd.odometry.series",
    "mapperd.odometry.states",
    "mapperd.odometry.track",
    "mapperd.pipeline.counters",
    "mapperd.pipeline.decoder",
    "mapperd.pipeline.pose_lookup",
    "oculus_driver.clock",
    "oculus_driver.clock_fit",
    "oculus_driver.ping",
    "oculus_driver.stream",
)

FORMER_MODULES = {
    "mapperd.config": "mapperd.config.tree",
    "mapperd.config_filters": "mapperd.config.filters",
    "mapperd.config_odometry": "mapperd.config.odometry",
    "mapperd.config_outofcore": "mapperd.config.daemon",
    "mapperd.config_service": "mapperd.config.daemon",
    "mapperd.counters": "mapperd.pipeline.counters",
    "mapperd.engine": "mapperd.pipeline.decoder",
    "mapperd.filters.robot": "mapperd.imaging.robots",
    "mapperd.filters.sightings": "mapperd.imaging.robots",
    "mapperd.frames": "mapperd.geometry.frames",
    "mapperd.geodesy": "mapperd.geometry.geodesy",
    "mapperd.localization.burst": "mapperd.localization.burst_filter",
    "mapperd.localization.cloud_state": "mapperd.localization.particle_filter",
    "mapperd.localization.estimate": "mapperd.geometry.gaussian",
    "mapperd.localization.fit_watch": "mapperd.localization.hypothesis",
    "mapperd.localization.onboard": "mapperd.localization.stage",
    "mapperd.localization.pose": "mapperd.localization.odom_correction",
    "mapperd.odometry.anchor": "mapperd.odometry.track",
    "mapperd.odometry.confidence": "mapperd.odometry.gate",
    "mapperd.odometry.jump": "mapperd.odometry.track",
    "mapperd.odometry.lines": "mapperd.odometry.decoder",
    "mapperd.odometry.lookup": "mapperd.odometry.series",
    "mapperd.odometry.mavlink_frames": "mapperd.odometry.mavlink",
    "mapperd.odometry.mavlink_time": "mapperd.odometry.mavlink",
    "mapperd.odometry.native_serial": "mapperd.odometry.native",
    "mapperd.odometry.precedence": "mapperd.odometry.clock",
    "mapperd.odometry.stamps": "mapperd.odometry.clock",
    "mapperd.odometry.utc": "mapperd.odometry.nmea",
    "mapperd.pairing": "mapperd.pipeline.pose_lookup",
    "mapperd.ping_stream": "mapperd.pipeline.decoder",
    "mapperd.reject": "mapperd.errors",
    "oculus_driver.envelope": "oculus_driver.clock_fit",
    "oculus_driver.sequence": "oculus_driver.ping",
}
"""Names of modules in earlier checkpoints, and what they are called now."""

FORMER_CLASSES = {
    "mapperd.localization.hypothesis:Rival": "AlternativeHypothesis",
    "mapperd.localization.stage:Onboard": "LocalizationStage",
    "mapperd.pipeline.decoder:Engine": "SessionDecoder",
    "mapperd.pipeline.decoder:Settled": "PosedPing",
    "mapperd.pipeline.pose_lookup:PoseSource": "PoseLookup",
    "mapperd.pipeline.counters:ReplayCounters": "PipelineCounters",
    "oculus_driver.clock_fit:LowerEnvelope": "ClockFit",
}
"""Classes in earlier checkpoints, in modules as they are called now."""

KEPT = {
    "mapperd.pipeline.decoder:SessionDecoder": frozenset({"counters", "_within"}),
    "mapperd.odometry.mavlink:MavlinkFrames": frozenset({"_codec"}),
    "mapperd.odometry.nmea:NmeaReader": frozenset({"_readers"}),
}
"""Attributes that are as the fresh object has them: tables, libraries, counts for people."""


def name_of(kind: type) -> str:
    """What a checkpoint calls a class.

    Raises:
        TypeError: it is not meant to stand in one; our own mistake.
    """
    if kind.__module__ not in MODULES:
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot stand in a checkpoint")
    return f"{kind.__module__}:{kind.__qualname__}"


def class_named(name: str) -> type[Any]:
    """The class that a checkpoint names.

    Raises:
        CheckpointError: there is none.
    """
    module_name, _, qualname = _name_now(name).partition(":")
    module = sys.modules.get(module_name)  # the fresh objects have imported all that they need
    if module is not None and module_name in MODULES:
        kind = vars(module).get(qualname)
        if isinstance(kind, type) and kind.__module__ == module_name:
            return kind
    raise CheckpointError(f"knows no {name[:100]!r}")


def kept_of(name: str) -> frozenset[str]:
    """Attributes of a class that are no state."""
    return KEPT.get(_name_now(name), frozenset())


def _name_now(name: str) -> str:
    module, _, kind = name.partition(":")
    module = FORMER_MODULES.get(module, module)
    return f"{module}:{FORMER_CLASSES.get(f'{module}:{kind}', kind)}"


def is_frozen(kind: type) -> bool:
    """Whether objects never change, so that nobody can tell two equal ones apart."""
    if is_dataclass(kind):
        return bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]
    return issubclass(kind, (Enum, Struct))


FORMAT = 1
"""Another way of writing, or of reading what is written, is another number."""


class Tag(StrEnum):
    """First element of a list."""

    LIST = "l"
    TUPLE = "t"
    SET = "s"
    FROZENSET = "f"
    DEQUE = "q"
    DICT = "d"
    COUNTER = "c"
    BYTEARRAY = "y"
    BIG = "i"
    ENUM = "e"
    STRUCT = "u"
    ARRAY = "a"
    SCALAR = "n"
    OBJECT = "o"
    AGAIN = "r"
    KEPT = "k"
    ROWS = "w"


def attributes_of(value: object) -> Iterator[tuple[str, Any]]:
    """Names and values of all that an object holds, in a fixed order."""
    for kind in type(value).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in ("__weakref__", "__dict__") and hasattr(value, name):
                yield name, getattr(value, name)
    yield from getattr(value, "__dict__", {}).items()
