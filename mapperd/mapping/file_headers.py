"""Headers of map files: what a `.map` or a tree of OctoMap tells of the settings of its map."""

import math
import re
import struct
from typing import Any

from mapperd import _core
from mapperd.config.tree import Config
from mapperd.errors import MapError

__all__ = [
    "map_header_bytes",
    "octomap_with_rule",
    "settings_of_map",
    "settings_of_octomap",
]

MAP_HEADER = struct.Struct("<Idii")
"""Header of a `.map` after its magic: version, voxel edge, clamps in units of log-odds."""

PRIOR = struct.Struct("<i")
"""In version 2 the log-odds of an unobserved voxel follow, in the same units."""

COUNTS = struct.Struct("<HQ")
"""End of the header: observations that a voxel counts, and number of blocks."""

WITH_PRIOR = 2

WRITTEN_BY = b"# Written by mapperd\n"

OCTOMAP_RESOLUTION = re.compile(r"^res\s+(\S+)\s*$", re.MULTILINE)
OCTOMAP_RULE = re.compile(r"^# Written by mapperd by rule arc of prior (\S+)$", re.MULTILINE)


def map_header_bytes(data: bytes) -> int:
    """Return the length of the header of a whole `.map`."""
    at = len(_core.MAP_FILE_MAGIC)
    version, *_ = MAP_HEADER.unpack_from(data, at)
    return at + MAP_HEADER.size + (PRIOR.size if version == WITH_PRIOR else 0) + COUNTS.size


def settings_of_map(begin: bytes) -> dict[str, Any]:
    """Return the settings, by full name, that the header of a `.map` holds.

    Args:
        begin: the beginning of the file.

    Raises:
        MapError: it ends too early.
    """
    at = len(_core.MAP_FILE_MAGIC)
    if len(begin) < at + MAP_HEADER.size + PRIOR.size:
        raise MapError("map file: it ends too early", "bad_map_file")
    version, resolution_m, low, high = MAP_HEADER.unpack_from(begin, at)
    clamps = low * _core.LOG_ODDS_UNIT, high * _core.LOG_ODDS_UNIT
    found: dict[str, Any] = {"octree.voxel_resolution": resolution_m}
    if version != WITH_PRIOR:
        iwlo = {"mapping.rule": "iwlo", "iwlo.L_min": clamps[0], "iwlo.L_max": clamps[1]}
        return found | iwlo
    (units,) = PRIOR.unpack_from(begin, at + MAP_HEADER.size)
    log_odds = units * _core.LOG_ODDS_UNIT
    return found | {
        "mapping.rule": "arc",
        "arc.prior": _prior_of(units),
        "arc.lowest": round(clamps[0] + log_odds, 6),
        "arc.highest": round(clamps[1] + log_odds, 6),
    }


def _prior_of(units: int) -> float:
    """Return the probability of log-odds in units, the shorter number if it has the same units."""
    prior = 1 / (1 + math.exp(-units * _core.LOG_ODDS_UNIT))
    short = round(prior, 6)
    is_same = 0 < short < 1 and round(math.log(short / (1 - short)) / _core.LOG_ODDS_UNIT) == units
    return short if is_same else prior


def settings_of_octomap(begin: bytes) -> dict[str, Any]:
    """Return the settings, by full name, that the header of a tree of OctoMap holds.

    A `.bt` holds classes alone, which are the same by every rule: it reads as one of IWLO.

    Args:
        begin: the beginning of the file.

    Raises:
        MapError: a number in it is none.
    """
    text = begin.partition(b"\ndata\n")[0].decode("latin-1")
    found: dict[str, Any] = {"mapping.rule": "iwlo"}
    edge, prior = OCTOMAP_RESOLUTION.search(text), OCTOMAP_RULE.search(text)
    try:
        if edge is not None:
            found["octree.voxel_resolution"] = float(edge[1])
        if prior is not None and not begin.startswith(b"# Octomap OcTree binary"):
            found |= {"mapping.rule": "arc", "arc.prior": float(prior[1])}
    except ValueError:
        text = "its resolution or its prior is not a number"
        raise MapError(text, "bad_octomap_file") from None
    return found


def octomap_with_rule(data: bytes, config: Config) -> bytes:
    """Return a tree of OctoMap with the rule in its header; one of IWLO is as it was."""
    if config.mapping.rule == "iwlo":
        return data
    named = f"# Written by mapperd by rule arc of prior {config.arc.prior!r}\n"
    return data.replace(WRITTEN_BY, named.encode(), 1)
