"""Status, localization and settings as text for people."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from textwrap import wrap
from typing import Any

from mapperd.cli.mapperctl.connection import plain

__all__ = ["event_line", "localization_lines", "params_lines", "status_lines"]

MIB = 1 << 20
COLUMNS = 80
NAME_LETTERS = 14
MAX_PROBLEMS = 3
OLD_S = 2.0
"""Age at which poses and odometry are marked."""

RED, YELLOW, GREEN = "31", "33", "32"

Values = Mapping[str, Any]


def status_lines(status: Values, before: Values | None, *, colours: bool = False) -> Iterator[str]:
    """The problems, a headline, and a line for each part; at most 80 columns.

    Args:
        status: of a daemon, maybe of another version.
        before: earlier status, for rates; None omits them.
        colours: for a terminal.
    """
    painted = partial(_painted, colours=colours)
    problems = [one for one in status.get("problems") or () if isinstance(one, Mapping)]
    for problem in problems[:MAX_PROBLEMS]:
        yield from painted(wrap(plain(f"! {problem.get('text')}"), COLUMNS), RED)
    if len(problems) > MAX_PROBLEMS:
        yield from painted([f"! {len(problems) - MAX_PROBLEMS} more problems: --json"], RED)
    activity = status.get("activity") or status.get("phase")
    name = " ".join(filter(None, ("mapperd", status.get("version"), activity)))
    yield plain(f"{name}, up {_duration(status.get('uptime_s', 0.0))}")
    for name, (texts, colour) in _parts(status, before):
        yield from painted(_lines(name, [plain(text) for text in texts if text]), colour)


def _lines(name: str, texts: list[str]) -> list[str]:
    """A name and its texts, broken between texts where they fit, else between words."""
    lines: list[str] = []
    for text in texts:
        if lines and len(lines[-1]) + len(text) + 3 <= COLUMNS - NAME_LETTERS:
            lines[-1] += f", {text}"
            continue
        if lines:
            lines[-1] += ","
        lines += wrap(text, COLUMNS - NAME_LETTERS - 1)
    names = [name, *[""] * len(lines)]
    return [f"{at:<{NAME_LETTERS}}{line}" for at, line in zip(names, lines, strict=False)]


Part = tuple[list[str], str]
"""Texts of a line and their colour."""


def _parts(status: Values, before: Values | None) -> Iterator[tuple[str, Part]]:
    now_s = status.get("t_s")
    yield "vehicle", _vehicle(status.get("pose"), now_s, _part(status, "odometry"))
    yield "sonar", _sonar(_part(status, "sonar"), _rate(status, before, "sonar", "pings"))
    odometry = _part(status, "odometry")
    for name, link in _part(odometry, "connections").items():
        state = str(link.get("state"))
        yield "odometry", ([f"{name} {state}"], GREEN if state == "receiving" else YELLOW)
    ages = [
        f"{name} {_age(newest / 1e9, now_s)}"
        for name, one in _part(odometry, "quantities").items()
        if isinstance(newest := one.get("newest_ns"), int)
    ]
    yield "", (ages, "")
    pings = _part(status, "pings")
    latency = _with_unit(_part(status, "latency_ms").get("p95"), "ms", "latency ")
    rate = _rate(status, before, "pings", "mapped")
    counts = [f"{pings.get('mapped', 0)} mapped{rate}"] if pings else []
    yield "pings", ([*counts, _dropped(pings), latency], "")
    behind = _part(status, "behind")
    if behind.get("late"):
        text = f"pings come faster than they can be mapped, {behind.get('dropped')} dropped"
        yield "", ([text], YELLOW)
    yield "map", _map(_part(status, "map"), _part(status, "store"))
    yield "recording", _recording(status)
    yield "localization", _localized(_part(status, "localization"))
    clients = _part(_part(status, "servers"), "stream").get("clients")
    yield "clients", ([f"{clients}"] if clients else [], "")


def _vehicle(pose: object, now_s: object, odometry: Values) -> Part:
    compass = odometry.get("north_referenced") is True
    if not isinstance(pose, Mapping):
        newest = _part(odometry, "newest")
        depth_m, turn = newest.get("depth_m"), newest.get("map_q_base_wxyz")
        depth = f"depth {depth_m:.2f} m" if isinstance(depth_m, int | float) else ""
        return [depth, _heading(turn, compass=compass) if turn else ""], YELLOW
    x_m, y_m, z_m = pose["position_m"]
    std_m = math.hypot(*pose["position_std_m"][:2])
    age_s = now_s - pose["t_s"] if _numbers(now_s, pose.get("t_s")) else 0.0
    where = [f"x {x_m:.2f} m", f"y {y_m:.2f} m", f"depth {-z_m:.2f} m"]
    rest = [
        _heading(pose["map_q_base_wxyz"], compass=compass),
        f"± {std_m:.2f} m",
        _age(pose.get("t_s"), now_s),
    ]
    return [*where, *rest], YELLOW if age_s > OLD_S else ""


def _heading(map_q_base_wxyz: Sequence[float], *, compass: bool) -> str:
    """Return the compass heading, or the yaw where the odometry's world has no north."""
    w, x, y, z = map_q_base_wxyz
    yaw_deg = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    return f"heading {round(90 - yaw_deg) % 360:03}°" if compass else f"yaw {yaw_deg:+.0f}°"


def _sonar(sonar: Values, rate: str) -> Part:
    state = str(sonar.get("state") or "")
    good = state == "pinging"
    model, address = sonar.get("model"), sonar.get("address")
    texts = [
        f"{state}{rate}" if good or not sonar.get("reason") else f"{state}: {sonar['reason']}",
        " at ".join(str(one) for one in (model, address) if one),
        _with_unit(sonar.get("range_m"), "m", "range "),
        _with_unit(sonar.get("gain_percent"), "%", "gain "),
        _with_unit(sonar.get("temperature_c"), "°C"),
        f"{lost} lost" if (lost := sonar.get("pings_lost")) else "",
    ]
    return texts, GREEN if good else YELLOW


def _dropped(pings: Values) -> str:
    reasons = _part(pings, "dropped")
    named = ", ".join(f"{_words(name)} {count}" for name, count in reasons.items())
    total = sum(count for count in reasons.values() if isinstance(count, int))
    return f"{total} dropped ({named})" if total else ""


def _map(facts: Values, store: Values) -> Part:
    used = facts.get("memory_bytes")
    texts = [
        _with_unit(facts.get("resolution_m"), "m", "voxels of "),
        _rule(facts),
        f"{used / MIB:.1f} MiB in memory" if isinstance(used, int) else "",
        f"kept in {store['path']}" if store.get("path") else "",
        f"{lost} bricks lost" if (lost := store.get("bricks_lost")) else "",
        str(store.get("reason") or ""),
    ]
    return texts, YELLOW if store.get("reason") or lost else ""


def _rule(facts: Values) -> str:
    """The rule and what it knows of surfaces; nothing of the default one."""
    if facts.get("rule") in (None, "iwlo"):
        return ""
    level, returns = facts.get("surface_level"), facts.get("surface_returns")
    source = "set" if returns is None else f"from {returns} first returns"
    shown = f", surfaces at level {level:.1f} ({source})" if isinstance(level, float) else ""
    return f"rule {facts['rule']}{shown}"


def _recording(status: Values) -> Part:
    if "recording" not in status:
        return [], ""
    recording = _part(status, "recording")
    if not recording:
        return ["off"], YELLOW
    written, dropped = recording.get("bytes_written"), recording.get("bytes_dropped")
    texts = [
        ": ".join(str(recording[name]) for name in ("state", "reason") if recording.get(name)),
        f"{written / MIB:.1f} MiB" if isinstance(written, int) else "",
        f"{dropped} bytes dropped" if dropped else "",
    ]
    return texts, GREEN if recording.get("state") == "logging" else YELLOW


def _localized(facts: Values) -> Part:
    texts = [f"{facts.get('state')} on {facts.get('map') or 'no map'}"] if facts else []
    if _numbers(facts.get("x_m"), facts.get("y_m"), facts.get("yaw_deg")):
        texts += [f"x {facts['x_m']:.2f} m", f"y {facts['y_m']:.2f} m"]
        texts += [f"yaw {facts['yaw_deg']:.1f}°"]
    good = facts.get("state") == "localized" and facts.get("diagnostics") != "WARN"
    return texts, "" if good else YELLOW


def _painted(lines: list[str], colour: str, *, colours: bool) -> Iterator[str]:
    for line in lines:
        yield f"\x1b[{colour}m{line}\x1b[0m" if colour and colours else line


def _part(values: Values, name: str) -> Values:
    found = values.get(name)
    return found if isinstance(found, Mapping) else {}


def _numbers(*values: object) -> bool:
    return all(isinstance(value, int | float) for value in values)


def _with_unit(value: object, unit: str, before: str = "") -> str:
    return f"{before}{value:.4g} {unit}" if isinstance(value, int | float) else ""


def _age(t_s: object, now_s: object) -> str:
    if not isinstance(t_s, int | float) or not isinstance(now_s, int | float):
        return ""
    age_s = max(now_s - t_s, 0.0)
    return f"{age_s:.1f} s ago" if age_s < 60 else f"{_duration(age_s)} ago"  # noqa: PLR2004 s


def event_line(event: Mapping[str, Any], clock: str) -> str:
    """A line for an event; `clock` is its time as text."""
    return plain(f"{clock} {event.get('severity', ''):<7} {event.get('text', '')}")


def _words(name: str) -> str:
    return name.replace("_", " ").strip()


def _duration(seconds: object) -> str:
    whole = int(seconds) if isinstance(seconds, int | float) else 0
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def _rate(status: Values, before: Values | None, part: str, name: str) -> str:
    """Return the rate of a counter since an earlier status."""
    if before is None or not _numbers(status.get("uptime_s"), before.get("uptime_s")):
        return ""
    passed_s = status["uptime_s"] - before["uptime_s"]
    now, then = _part(status, part).get(name), _part(before, part).get(name)
    if not isinstance(now, int) or not isinstance(then, int) or passed_s <= 0 or now < then:
        return ""  # the daemon restarted
    return f" {(now - then) / passed_s:.1f}/s"


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
        facts: from `mapperd.config.live.facts_of`.
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
