"""Status, localization and settings as text for people."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from mapperd.cli.mapperctl.errors import plain

__all__ = ["event_line", "localization_lines", "params_lines", "status_lines"]

UNITS = {"_m": "m", "_s": "s", "_ms": "ms", "_hz": "Hz", "_deg": "deg", "_c": "°C", "_percent": "%"}
MIB = 1 << 20
NAME_LETTERS = 10


def status_lines(status: Mapping[str, Any], before: Mapping[str, Any] | None) -> Iterator[str]:
    """A headline, and a line for each part that is not empty.

    Args:
        status: status of the daemon.
        before: earlier status, for rates; None omits them.
    """
    name = " ".join(filter(None, ("mapperd", status.get("version"), status.get("phase"))))
    reason = status.get("reason")
    head = f"{name}: {reason}" if reason else name
    yield plain(f"{head}, up {_duration(status.get('uptime_s', 0.0))}{_rate(status, before)}")
    for problem in status.get("problems", ()):
        yield plain(f"{'problem':<{NAME_LETTERS}} {problem.get('text', '')}")
    for name, part in status.items():
        if isinstance(part, Mapping):
            text = ", ".join(_described("", part))
            if text:
                yield plain(f"{name:<{NAME_LETTERS}} {text}")


def event_line(event: Mapping[str, Any], clock: str) -> str:
    """A line for an event; `clock` is its time as text."""
    return plain(f"{clock} {event.get('severity', ''):<7} {event.get('text', '')}")


def _described(prefix: str, part: Mapping[str, Any]) -> Iterator[str]:
    for key, value in part.items():
        name = f"{prefix} {key}".strip()
        if isinstance(value, Mapping):
            yield from _described(name, value)
        elif value not in (None, "", []) and value is not False and not _is_table(value):
            yield _with_unit(name, value)


def _is_table(value: object) -> bool:
    """Whether a value is a table, which only `--json` prints."""
    return isinstance(value, list) and isinstance(value[0], Mapping)


def _with_unit(name: str, value: object) -> str:
    if isinstance(value, list):
        inner = [_number(one) if isinstance(one, int | float) else str(one) for one in value]
        value_text = f"({', '.join(inner)})"
    elif value is True:
        return _words(name)
    elif isinstance(value, int | float):
        if name.endswith("bytes"):
            return f"{_words(name.removesuffix('bytes'))} {value / MIB:.1f} MiB".strip()
        value_text = _number(value)
    else:
        value_text = str(value)
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return f"{_words(name.removesuffix(suffix))} {value_text} {unit}"
    return f"{_words(name)} {value_text}"


def _words(name: str) -> str:
    return name.replace("_", " ").strip()


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def _duration(seconds: object) -> str:
    whole = int(seconds) if isinstance(seconds, int | float) else 0
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def _rate(status: Mapping[str, Any], before: Mapping[str, Any] | None) -> str:
    if before is None:
        return ""
    passed_s = status.get("uptime_s", 0.0) - before.get("uptime_s", 0.0)
    mapped = _mapped(status) - _mapped(before)
    if passed_s <= 0 or mapped < 0:  # the daemon restarted
        return ""
    return f", {mapped / passed_s:.1f} pings/s"


def _mapped(status: Mapping[str, Any]) -> int:
    pings = status.get("pings")
    return int(pings.get("mapped", 0)) if isinstance(pings, Mapping) else 0


Values = Mapping[str, Any]


def localization_lines(state: Values) -> Iterator[str]:
    """A headline, and lines for pose, ambiguity, clusters and transform."""
    if state.get("mode") == "off":
        yield "localization is off: localization.mode"
        return
    on = state.get("map") or "no map"
    yield plain(f"{state.get('state')}, mode {state.get('mode')}, {on}")
    if state.get("pose"):
        yield plain(f"pose      {_pose(state['pose'])}, of {state['particles']} particles")
        share = 100 * state["elsewhere"]
        yield plain(f"elsewhere {share:.1f} % of the weight{_ambiguous(state)}")
    diagnostics = state.get("diagnostics") or {}
    yield plain(f"levels    {diagnostics.get('level')}: {diagnostics.get('text')}")
    if state.get("warning"):
        yield plain(f"warning   {state['warning']}")
    for cluster in state.get("clusters") or ():
        yield plain(f"cluster   {100 * cluster['mass']:.1f} % at {_pose(cluster)}")
    if state.get("map_odom"):
        yield plain(f"map_odom  {_transform(state['map_odom'])}")
    counts = ", ".join(f"{name} {count}" for name, count in (state.get("counts") or {}).items())
    yield plain(f"scans     {counts or 'none'}")


def _pose(pose: Values) -> str:
    x_m, y_m, yaw_rad = (math.sqrt(max(pose["covariance"][k][k], 0.0)) for k in range(3))
    return (
        f"x {pose['x_m']:.2f} ± {x_m:.2f} m, y {pose['y_m']:.2f} ± {y_m:.2f} m, "
        f"yaw {math.degrees(pose['yaw_rad']):.1f} ± {math.degrees(yaw_rad):.1f}°"
    )


def _ambiguous(state: Values) -> str:
    return ": ambiguous" if state.get("ambiguous") else ""


def _transform(transform: Values) -> str:
    x_m, y_m, _ = transform["position_m"]
    w, _, _, z = transform["orientation_wxyz"]
    yaw_deg = math.degrees(2 * math.atan2(z, w))
    return f"x {x_m:.2f} m, y {y_m:.2f} m, yaw {yaw_deg:.1f}°"


def params_lines(facts: Mapping[str, Mapping[str, Any]], *, origin: bool) -> Iterator[str]:
    """A line for each setting: name, value, unit, and where the value comes from.

    Args:
        facts: from `mapperd.config.changes.facts_of`.
        origin: include where the value comes from.
    """
    for name, fact in facts.items():
        unit = f" {fact['unit']}" if _is_measure(fact) else ""
        source = f"  # {plain(fact['origin'])}" if origin else ""
        yield f"{name} = {json.dumps(fact['value'])}{unit}{source}"


def _is_measure(fact: Mapping[str, Any]) -> bool:
    """Whether a setting is a number with a unit, not a text or a ratio with a scale."""
    default, unit = fact["default"], fact["unit"]
    number = isinstance(default, int | float) and not isinstance(default, bool)
    return number and not unit[:1].isdigit() and unit != ""
