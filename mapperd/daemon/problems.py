"""What keeps a session from mapping or recording, one line each with what still works and a remedy.

Pure: the status of the daemon in, problems out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mapperd.config.odometry import FIXED, NOBODY, OdometryFusionConfig
from mapperd.config.tree import Config
from mapperd.odometry.links import LinkPhase
from oculus_driver.link.state import LinkState

__all__ = ["PATIENCE_S", "Problem", "problems_of"]

PATIENCE_S = 5.0
"""Time after the start within which sonar and odometry are expected."""

MAX_REASONS = 3

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem.

    Attributes:
        code: `no_sonar`, `sonar_in_use`, `sonar_unreachable`, `sonar_silent`, `no_odometry`,
            `odometry_link`, `odometry_rejected`, `no_attitude`, `no_position`,
            `recording_paused`.
        text: what is wrong and what to do, one line.
        link: the odometry source that it is about, or "".
    """

    code: str
    text: str
    link: str = ""


def problems_of(status: Values, config: Config) -> list[Problem]:
    """Return the problems of a session, the most severe first; empty in its first seconds.

    Args:
        status: with `uptime_s`, `sonar`, `odometry` and `recording`, as of `DaemonApi.status`.
        config: in force.
    """
    if status["uptime_s"] < PATIENCE_S:
        return []
    return [
        *_sonar(status["sonar"], config),
        *_odometry(status["odometry"], config.odometry),
        *_recording(status["recording"]),
    ]


def _sonar(sonar: Values, config: Config) -> Iterator[Problem]:
    state, reason, given = sonar["state"], sonar["reason"], config.device.address
    if state == LinkState.SEARCHING:
        if " in use by " in reason:
            yield Problem("sonar_in_use", reason)
            return
        yield Problem(
            "no_sonar",
            f"no sonar: {reason}. Check power and cable, wait 20 s after power-up, and give this "
            "computer an address in the sonar's network; if broadcasts are blocked, set "
            "device.address",
        )
    elif state in (LinkState.CONNECTING, LinkState.BACKING_OFF):
        remedy = (
            f'. If {given} is wrong, correct device.address; "" finds the sonar by its broadcasts'
            if given
            else ""
        )
        where = sonar["address"] or given
        yield Problem("sonar_unreachable", f"the sonar at {where} sends nothing: {reason}{remedy}")
    elif state == LinkState.SILENT:
        yield Problem("sonar_silent", f"the sonar does not ping: {reason}; see `mapperd doctor`")


def _odometry(odometry: Values, config: OdometryFusionConfig) -> Iterator[Problem]:
    if odometry["source"] != "odometry":  # a vehicle that stands still needs none
        return
    links = odometry["connections"]
    quiet = {name: one for name, one in links.items() if one["state"] != LinkPhase.RECEIVING}
    if len(quiet) == len(links):
        where = ", ".join(f"{one['link']} ({name})" for name, one in links.items())
        yield Problem(
            "no_odometry",
            f"no odometry: nothing arrives on {where}. The sonar is recorded and shown, its pings "
            "are not mapped. Let the vehicle send there, or correct odometry.sources; "
            "`mapperd doctor` checks each link",
        )
        return
    for name, one in quiet.items():
        why = f": {one['reason']}" if one["reason"] else ""
        text = f"odometry source {name} ({one['link']}) is {one['state']}{why}"
        yield Problem("odometry_link", f"{text}; `mapperd doctor` checks each link", name)
    if odometry["received"] and not odometry["accepted"]:
        yield Problem(
            "odometry_rejected",
            f"every odometry record is rejected: {_counts(odometry['rejected'])}. "
            "docs/guides/odometry.md explains the reasons",
        )
    elif odometry["accepted"]:
        yield from _missing(odometry, config)


def _missing(odometry: Values, config: OdometryFusionConfig) -> Iterator[Problem]:
    """What a pose lacks, of the records that arrive."""
    has = {name for name, one in odometry["quantities"].items() if one["newest_ns"] is not None}
    arriving = " and ".join(sorted(has)) or "nothing usable"
    rest = "The sonar is recorded and shown, its pings are not mapped"
    if "attitude" not in has:
        yield Problem(
            "no_attitude",
            f"the odometry has no attitude, only {arriving}. {rest}. Add a source of the attitude "
            f"to odometry.sources{_awaited('attitude', odometry, config)}",
        )
    elif not has & {"position", "velocity"} and config.owners.position != FIXED:
        awaited = [_awaited(one, odometry, config) for one in ("position", "velocity")]
        yield Problem(
            "no_position",
            f"the odometry has neither horizontal position nor velocity, only {arriving}. {rest}. "
            "Add a DVL or another position to odometry.sources, or map from one spot with "
            f"odometry.owners.position: {FIXED}{''.join(awaited)}",
        )


def _awaited(quantity: str, odometry: Values, config: OdometryFusionConfig) -> str:
    """Why the source that owns a quantity does not provide it, if one is named."""
    owner = getattr(config.owners, quantity)
    if owner in ("", NOBODY, FIXED):
        return ""
    rejected = odometry["sources"].get(owner, {}).get("rejected", {})
    why = f", which sent: {_counts(rejected)}" if rejected else ", which sent none"
    return f"; {quantity} is expected from {owner}{why}"


def _recording(recording: Values | None) -> Iterator[Problem]:
    if recording is not None and recording["state"] == "paused":
        yield Problem(
            "recording_paused",
            f"recording is paused: {recording['reason'] or 'the disk cannot be written'}. Delete "
            "files, or lower recording.budget",
        )


def _counts(counts: Values) -> str:
    most = sorted(counts.items(), key=lambda item: -item[1])[:MAX_REASONS]
    return ", ".join(f"{reason} {count}" for reason, count in most)
