"""How it goes, for people: a few lines out of what `status` says."""

from collections.abc import Iterator, Mapping
from typing import Any

from mapperd.cli.mapperctl.errors import plain

__all__ = ["event_line", "status_lines"]

UNITS = {"_m": "m", "_s": "s", "_ms": "ms", "_hz": "Hz", "_deg": "deg", "_c": "°C", "_percent": "%"}
MIB = 1 << 20
NAME_LETTERS = 10


def status_lines(status: Mapping[str, Any], before: Mapping[str, Any] | None) -> Iterator[str]:
    """A headline, and a line for each part that has something to say.

    Args:
        status: as the daemon says it.
        before: said earlier, for rates; None is nothing.
    """
    name = " ".join(filter(None, ("mapperd", status.get("version"), status.get("phase"))))
    reason = status.get("reason")
    head = f"{name}: {reason}" if reason else name
    yield plain(f"{head}, up {_duration(status.get('uptime_s', 0.0))}{_rate(status, before)}")
    for name, part in status.items():
        if isinstance(part, Mapping):
            said = ", ".join(_said("", part))
            if said:
                yield plain(f"{name:<{NAME_LETTERS}} {said}")


def event_line(event: Mapping[str, Any], clock: str) -> str:
    """One event; `clock` is its time for a person."""
    return plain(f"{clock} {event.get('severity', ''):<7} {event.get('text', '')}")


def _said(prefix: str, part: Mapping[str, Any]) -> Iterator[str]:
    for key, value in part.items():
        name = f"{prefix} {key}".strip()
        if isinstance(value, Mapping):
            yield from _said(name, value)
        elif value not in (None, "", []) and value is not False and not _is_table(value):
            yield _with_unit(name, value)


def _is_table(value: object) -> bool:
    """Rows of facts are for programs: they are in `--json`."""
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
    if passed_s <= 0 or mapped < 0:  # it was started anew
        return ""
    return f", {mapped / passed_s:.1f} pings/s"


def _mapped(status: Mapping[str, Any]) -> int:
    pings = status.get("pings")
    return int(pings.get("mapped", 0)) if isinstance(pings, Mapping) else 0
