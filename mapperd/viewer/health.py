"""State of the connection and the daemon, for the page."""

import errno
import html
import math
import os
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mapperd.client.changes import ConnectionStatus
from mapperd.viewer.colours import Legend

__all__ = ["Health", "banner_html", "health_html", "legend_html", "summary_html", "text_of"]

WINDOW_S = 3.0
"""Window of rates."""

OLD_POSE_S = 2.0
OLD_MAP_S = 5.0

SAVED = ("file", "replay")
"""Beginnings of the phases in which nothing is live."""

NOBODY_THERE = (os.strerror(errno.ENOENT), os.strerror(errno.ECONNREFUSED))

GREEN, AMBER, RED = "#22c55e", "#f59e0b", "#ef4444"


class Rate:
    """Growth rate of a counter over the last seconds."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()

    def add(self, now_s: float, count: float) -> None:
        """Add a reading; a counter that falls starts again."""
        if self._seen and count < self._seen[-1][1]:
            self._seen.clear()
        self._seen.append((now_s, count))
        while len(self._seen) > 2 and self._seen[1][0] <= now_s - WINDOW_S:  # noqa: PLR2004 two make a rate
            self._seen.popleft()

    @property
    def per_s(self) -> float | None:
        """The rate, or None with fewer than two readings."""
        if len(self._seen) < 2:  # noqa: PLR2004
            return None
        (first_s, first), (last_s, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else None


@dataclass(slots=True)
class Health:
    """State of the connection; times are monotonic seconds of this computer.

    The offset of the daemon's clock is estimated from the heartbeat with the least delay.

    Attributes:
        link: state of the connection; None before the first.
        lost_s: since when there is no connection, over all attempts; None while connected.
        pings, blocks, kilobytes: rates.
        left: blocks still to be received.
        dropped: dropped pings by reason, as the daemon counts them.
        skipped: messages skipped for lack of bandwidth.
        round_trip_s: round-trip time.
        pose_ns, map_ns: newest stamps, Unix time of the daemon's clock.
        phase: phase of the daemon, one word.
        activity: what it does, for people.
        shown: the file or recording that is shown in place of a live map; else empty.
        problems: what keeps the daemon from mapping, with the remedy.
        recording: state of the daemon's recording and its bytes; None where it records nothing.
        position_m, yaw_rad: of the vehicle; None before the first pose.
        depth_m, attitude_yaw_rad: newest ones of the odometry, shown before the first pose.
        north_referenced: yaw is from east, so that there is a compass heading.
        page_bytes, page_nodes, page_cells, page_waiting: the map in browsers.
    """

    link: ConnectionStatus | None = None
    lost_s: float | None = None
    pings: Rate = field(default_factory=Rate)
    blocks: Rate = field(default_factory=Rate)
    kilobytes: Rate = field(default_factory=Rate)
    left: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    skipped: int = 0
    round_trip_s: float | None = None
    pose_ns: int | None = None
    map_ns: int | None = None
    phase: str = ""
    activity: str = ""
    shown: str = ""
    problems: tuple[str, ...] = ()
    recording: tuple[str, int] | None = None
    position_m: tuple[float, float, float] | None = None
    yaw_rad: float = 0.0
    depth_m: float | None = None
    attitude_yaw_rad: float | None = None
    north_referenced: bool = False
    page_bytes: int = 0
    page_nodes: int = 0
    page_cells: int = 0
    page_waiting: int = 0
    ahead_ns: int | None = None

    @property
    def connected(self) -> bool:
        """Whether the daemon is connected."""
        return self.link is not None and self.link.state == "connected"

    def take_link(self, link: ConnectionStatus) -> None:
        """Update the connection's state; each attempt to connect has a state of its own."""
        again = self.link is not None and link.connects != self.link.connects
        if link.state == "connected":
            self.lost_s = None
        elif self.lost_s is None or again:
            self.lost_s = link.since_s
        self.link = link

    def heartbeat(self, stamp_ns: int, unix_ns: int) -> None:
        """Note the daemon's time stamp of a message that arrived now."""
        ahead = stamp_ns - unix_ns
        self.ahead_ns = ahead if self.ahead_ns is None else max(self.ahead_ns, ahead)

    def reconnected(self) -> None:
        """Discard the clock offset."""
        self.ahead_ns = None

    def age_s(self, stamp_ns: int | None, unix_ns: int) -> float | None:
        """Age of a time stamp of the daemon; None where nothing is live."""
        if stamp_ns is None or self.phase.startswith(SAVED):
            return None
        return max(0.0, (unix_ns + (self.ahead_ns or 0) - stamp_ns) / 1e9)

    def take_status(self, status: Mapping[str, Any], link: Mapping[str, Any], now_s: float) -> None:
        """Update from the daemon's status and its state of this connection."""
        pings = status.get("pings")
        if isinstance(pings, Mapping):
            numbers = {str(k): int(v) for k, v in pings.items() if isinstance(v, int | float)}
            self.pings.add(now_s, numbers.get("mapped", 0))
            dropped = pings.get("dropped")
            self.dropped = _counts(dropped) if isinstance(dropped, Mapping) else {}
        self.phase = str(status.get("phase", self.phase))
        self.activity = str(status.get("activity", self.phase))
        self.shown = Path(str(status.get("reason"))).name if self.phase.startswith(SAVED) else ""
        odometry = status.get("odometry")
        if isinstance(odometry, Mapping):
            self._take_odometry(odometry)
        problems = status.get("problems", ())
        self.problems = tuple(str(one["text"]) for one in problems if isinstance(one, Mapping))
        if "recording" in status:
            recording = status["recording"]
            self.recording = None
            if isinstance(recording, Mapping):
                words = (str(recording.get("state")), str(recording.get("reason") or ""))
                written = recording.get("bytes_written")
                size = int(written) if isinstance(written, int | float) else 0
                self.recording = (": ".join(filter(None, words)), size)
        trip = link.get("round_trip_s")
        self.round_trip_s = float(trip) if isinstance(trip, int | float) else None
        left = link.get("left")
        self.left = int(left) if isinstance(left, int | float) else self.left
        skipped = link.get("skipped")
        self.skipped = sum(_counts(skipped).values()) if isinstance(skipped, Mapping) else 0

    def _take_odometry(self, odometry: Mapping[str, Any]) -> None:
        self.north_referenced = odometry.get("north_referenced") is True
        newest = odometry.get("newest")
        if not isinstance(newest, Mapping):
            return
        self.depth_m, turn = newest.get("depth_m"), newest.get("map_q_base_wxyz")
        self.attitude_yaw_rad = None
        if turn:
            w, x, y, z = turn
            self.attitude_yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def health_html(health: Health, now_s: float, unix_ns: int) -> str:
    """The status panel."""
    state, colour, reason = _state(health, now_s)
    rows = [
        ("pings", _per_s(health.pings.per_s, 1), "blocks", _per_s(health.blocks.per_s, 0)),
        ("data", text_of(health.kilobytes.per_s, "kB/s", 1), "left", f"{health.left}"),
        (
            "pose age",
            _aged(health.age_s(health.pose_ns, unix_ns), OLD_POSE_S),
            "map age",
            _aged(health.age_s(health.map_ns, unix_ns), OLD_MAP_S),
        ),
        (
            "round trip",
            text_of(None if health.round_trip_s is None else health.round_trip_s * 1e3, "ms", 0),
            "skipped",
            f"{health.skipped}",
        ),
        ("cells", f"{health.page_cells:,}", "dropped", f"{sum(health.dropped.values())}"),
    ]
    cells = "".join(
        f"<tr><td {_LABEL}>{a}</td><td {_VALUE}>{b}</td>"
        f"<td {_LABEL}>{c}</td><td {_VALUE}>{d}</td></tr>"
        for a, b, c, d in rows
    )
    drops = ", ".join(f"{html.escape(k)} {v}" for k, v in sorted(health.dropped.items()) if v)
    waiting = f"drawing, {health.page_waiting} parts to go" if health.page_waiting else ""
    style = 'style="opacity:.85;overflow-wrap:anywhere"'
    notes = "".join(f"<div {style}>{n}</div>" for n in (reason, drops, waiting) if n)
    return (
        f'<div style="font-size:13px;line-height:1.45;padding:0 10px">'
        f'<div style="font-weight:700;font-size:16px;color:{colour}">&#9679; {state}</div>'
        f"{_vehicle(health)}{_recording(health)}{_problems(health)}{notes}"
        f'<table style="width:100%;border-collapse:collapse;margin-top:4px">{cells}</table>'
        f"</div>"
    )


def summary_html(health: Health, now_s: float) -> str:
    """A summary for phones: the vehicle, what is recorded, and a lost connection."""
    state, colour, _ = _state(health, now_s)
    lost = "" if health.connected else f'<b style="color:{colour}">&#9679; {state}</b>'
    return (
        '<div data-phone style="padding:6px 10px;line-height:1.5">'
        f"{lost}{_vehicle(health)}{_recording(health)}{_problems(health)}</div>"
    )


def banner_html(health: Health, now_s: float) -> str:
    """A large banner without a connection, otherwise nothing."""
    if health.connected:
        return ""
    state, _, reason = _state(health, now_s)
    lost = "the map shows the last state; reconnecting"
    rest = lost if health.link is not None and health.link.connects else "connecting"
    return (
        '<div data-banner style="position:fixed;top:34%;left:0;right:0;text-align:center;'
        'padding:0 8px;pointer-events:none;z-index:100"><span style="display:inline-block;'
        "box-sizing:border-box;max-width:min(100%,40em);overflow-wrap:anywhere;"
        "background:rgba(127,29,29,.92);color:#fff;padding:14px clamp(12px,4vw,36px);"
        'border-radius:10px;box-shadow:0 6px 30px rgba(0,0,0,.5)"><span style="font-weight:800;'
        f'font-size:clamp(24px,6vw,40px);letter-spacing:1px">{state}</span><br>'
        f'<span style="font-size:clamp(13px,3.6vw,16px)">{reason}<br>'
        f"{rest}</span></span></div>"
    )


def legend_html(legend: Legend) -> str:
    """A colour bar with tick labels."""
    ticks = "".join(f"<span>{html.escape(tick)}</span>" for tick in legend.ticks)
    return (
        '<div style="font-size:13px;padding:6px 10px 10px"><div style="margin-bottom:3px">'
        f"{html.escape(legend.title)}</div>"
        f'<div style="height:14px;border-radius:3px;background:linear-gradient(to right,'
        f'{",".join(legend.colours)})"></div><div style="display:flex;justify-content:'
        f'space-between;font-variant-numeric:tabular-nums">{ticks}</div></div>'
    )


def text_of(value: float | None, unit: str, digits: int) -> str:
    """A number with its unit; a dash for None."""
    return "&ndash;" if value is None else f"{value:.{digits}f} {unit}"


_LABEL = 'style="opacity:.85;padding-right:6px;white-space:nowrap"'
_VALUE = (
    'style="text-align:right;padding-right:10px;white-space:nowrap;'
    'font-variant-numeric:tabular-nums"'
)


def _state(health: Health, now_s: float) -> tuple[str, str, str]:
    link = health.link
    if link is None:
        return "NOT CONNECTED", AMBER, ""
    address = html.escape(link.address)
    if link.state == "connected" and health.shown:
        return html.escape(health.phase.upper()), GREEN, html.escape(health.shown)
    if link.state == "connected":
        phase = f" &middot; {html.escape(health.activity)}" if health.activity else ""
        return "CONNECTED", GREEN, f"daemon: {address}{phase}"
    lost_s = link.since_s if health.lost_s is None else health.lost_s
    since = _duration(max(0.0, now_s - lost_s))
    reason = ": ".join(filter(None, (address, html.escape(_remedy(link)))))
    first = "NO LINK" if link.connects == 0 else "LINK LOST"
    return f"{first} {since}", RED, reason


def _remedy(link: ConnectionStatus) -> str:
    """Return why there is no connection, and what to do if no daemon was there at all."""
    if link.reason not in NOBODY_THERE:
        return link.reason
    return "no daemon answers" + ("" if link.connects else ": start mapperd, or give --address")


def _vehicle(health: Health) -> str:
    """Position, depth and heading in large letters."""
    position_m = health.position_m
    depth_m = health.depth_m if position_m is None else -position_m[2]
    yaw_rad = health.attitude_yaw_rad if position_m is None else health.yaw_rad
    words = [] if depth_m is None else [f"depth <b>{depth_m:.2f} m</b>"]
    if yaw_rad is not None:
        yaw_deg = round(math.degrees(yaw_rad)) + 0.0  # no -0
        heading = f"heading {(90 - yaw_deg) % 360:03.0f}&deg;"
        words.append(heading if health.north_referenced else f"yaw {yaw_deg:+.0f}&deg;")
    if not words:
        return ""
    where = ""
    if position_m is not None:
        where = f"<br>x {position_m[0]:.2f} m &middot; y {position_m[1]:.2f} m"
    return (
        '<div data-vehicle style="font-size:15px;font-variant-numeric:tabular-nums">'
        f"{' &middot; '.join(words)}{where}</div>"
    )


def _recording(health: Health) -> str:
    if not health.connected or health.phase != "mapping":
        return ""
    if health.recording is None:
        return f'<div data-recording style="color:{AMBER}">not recorded</div>'
    state, size = health.recording
    colour = RED if state == "logging" else AMBER
    text = f"recording: {size / 1e6:,.0f} MB" if state == "logging" else f"recording {state}"
    return f'<div data-recording style="color:{colour}">&#9679; {html.escape(text)}</div>'


def _problems(health: Health) -> str:
    return "".join(
        f'<div style="color:{AMBER};margin:3px 0">&#9888; {html.escape(one)}</div>'
        for one in health.problems
    )


def _per_s(rate: float | None, digits: int) -> str:
    return text_of(rate, "/s", digits)


def _aged(age_s: float | None, limit_s: float) -> str:
    text = text_of(age_s, "s", 1)
    if age_s is None or age_s <= limit_s:
        return text
    return f'<span style="color:{AMBER};font-weight:700">{text}</span>'


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    return f"{minutes}:{rest:02d}" if minutes else f"{rest} s"


def _counts(numbers: Mapping[str, Any]) -> dict[str, int]:
    return {str(k): int(v) for k, v in numbers.items() if isinstance(v, int | float)}
