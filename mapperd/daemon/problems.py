"""What keeps a session from mapping or recording, one line each with what still works and a remedy.

Pure: the status of the daemon in, problems out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mapperd.config.odometry import FIXED, NOBODY, OdometryFusionConfig
from mapperd.config.tree import Config
from mapperd.daemon.doctor import PORT_REMEDIES, without_odometry
from mapperd.odometry.links import LinkPhase
from oculus_driver.link.state import LinkState

__all__ = ["GRACE_S", "Problem", "activity_of", "lost_bricks", "problems_of", "recording_problem"]

GRACE_S = 5.0
"""Time after the start within which sonar and odometry are expected."""

MAX_REASONS = 3
ONE_CLIENT = "It serves one client: close other programs that use it"
NO_PING = "no ping within"
"""Begin of the reason of a sonar that was asked for pings and sends none."""

HOUR_S = 3600.0
NOT_MAPPED = "The sonar is recorded and shown, its pings are not mapped"

BLOCKING = frozenset(
    {
        "no_sonar",
        "sonar_in_use",
        "sonar_unreachable",
        "sonar_silent",
        "no_odometry",
        "odometry_rejected",
        "no_attitude",
        "no_position",
    }
)
"""Codes of the problems with which no ping is mapped."""

SONAR = frozenset({"no_sonar", "sonar_in_use", "sonar_unreachable", "sonar_silent"})
"""Codes of the states in which a sonar sends no pings."""

SHORTAGES = {
    "free_space": "the disk has less free space than recording.free_floor",
    "budget": "the files have reached recording.budget",
}
"""Reasons why a recording pauses, for people."""

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem.

    Attributes:
        code: `no_sonar`, `sonar_in_use`, `sonar_unreachable`, `sonar_silent`, `no_odometry`,
            `odometry_quiet`, `odometry_format`, `clock_off`, `odometry_rejected`, `no_attitude`,
            `no_position`, `no_map`, `pose_unconfirmed`, `recording_paused`, `bricks_lost`.
        text: what is wrong and what to do, one line.
        link: the odometry source that it is about, or "".
    """

    code: str
    text: str
    link: str = ""

    @property
    def key(self) -> tuple[str, str]:
        """What the problem is about; another state of the sonar is the same problem."""
        return ("sonar" if self.code in SONAR else self.code, self.link)


def problems_of(status: Values, config: Config) -> list[Problem]:
    """Return the problems of a session, the most severe first; empty in its first seconds.

    Args:
        status: with `uptime_s`, `sonar`, `odometry`, `localization`, `recording` and `store` of
            `DaemonApi.status`.
        config: in force.
    """
    if status["uptime_s"] < GRACE_S:
        return []
    return [
        *_sonar(status["sonar"], config),
        *_odometry(status["odometry"], config.odometry),
        *_localization(status["localization"], config),
        *recording_problem(status["recording"]),
        *lost_bricks(status["store"]),
    ]


def activity_of(phase: str, status: Values) -> str:
    """Return what the daemon does, for headlines: its phase, but mapping only where it maps.

    Args:
        phase: of the daemon.
        status: with `problems` and `pings` of `DaemonApi.status`.
    """
    if phase != "mapping":
        return phase
    if any(one["code"] in BLOCKING for one in status["problems"]):
        return "not mapping"
    return phase if status["pings"].get("mapped") else "nothing mapped yet"


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
        text = f"the sonar at {where} sends nothing: {reason}. {ONE_CLIENT}"
        yield Problem("sonar_unreachable", f"{text}{remedy}")
    elif state == LinkState.SILENT or (
        state == LinkState.CONFIGURING and reason.startswith(NO_PING)
    ):
        yield Problem(
            "sonar_silent",
            f"the sonar does not ping: {reason}. {ONE_CLIENT}; `mapperd doctor` shows its state",
        )


def _odometry(odometry: Values, config: OdometryFusionConfig) -> Iterator[Problem]:
    if odometry["source"] != "odometry":  # a vehicle that stands still needs none
        return
    links = odometry["connections"]
    quiet = {name: one for name, one in links.items() if one["state"] != LinkPhase.RECEIVING}
    if len(quiet) == len(links):
        faults = "; ".join(_quiet(name, one) for name, one in links.items())
        yield Problem("no_odometry", f"no odometry: {faults}. {NOT_MAPPED}")
        return
    for name, one in quiet.items():
        text = f"an odometry source is quiet: {_quiet(name, one)}; `mapperd doctor` checks it"
        yield Problem("odometry_quiet", text, name)
    unusable = list(_unusable(odometry["links"], config))
    yield from unusable
    for name, one in odometry["sources"].items():
        if (offset_s := one.get("clock_offset_s")) is not None:
            yield Problem("clock_off", _clock_off(name, offset_s), name)
    if odometry["received"] and not odometry["accepted"] and not unusable:
        yield Problem(
            "odometry_rejected",
            f"every odometry record is rejected: {_counts(odometry['rejected'])}. "
            "docs/guides/odometry.md explains the reasons",
        )
    elif odometry["accepted"]:
        yield from _missing(odometry, config)


def _quiet(name: str, link: Values) -> str:
    """Why a link brings nothing, and what to do."""
    if link["state"] == LinkPhase.BACKING_OFF:
        kind = str(link["link"]).split(" ", 1)[0].lower()  # a serial link is its device
        return f"{link['reason']} ({name}): {PORT_REMEDIES.get(kind, PORT_REMEDIES['serial'])}"
    return (
        f"nothing arrives on {link['link']} ({name}): let the vehicle send there, or correct "
        "odometry.sources"
    )


def _unusable(links: Values, config: OdometryFusionConfig) -> Iterator[Problem]:
    """Sources that send bytes of another format, or messages without odometry."""
    for source in config.sources:
        one = links.get(source.name)
        if one is None or not one["bytes"] or one["records"]:
            continue
        if not one["frames"]:
            yield Problem(
                "odometry_format",
                f"nothing that arrives from odometry source {source.name} is of format "
                f"{source.format}: correct its format, or what sends to {source.link}",
                source.name,
            )
        elif not one["rejected"]:
            yield Problem(
                "odometry_format",
                f"odometry source {source.name} sends no odometry, only "
                f"{_counts(one['messages'])}: {without_odometry(source.format)}",
                source.name,
            )


def _clock_off(name: str, offset_s: float) -> str:
    side = "ahead of" if offset_s > 0 else "behind"
    size_s = abs(offset_s)
    short = f"{size_s:.1f} s" if size_s >= 1 else f"{1e3 * size_s:.0f} ms"
    amount = f"{size_s / HOUR_S:.1f} h" if size_s >= HOUR_S else short
    return (
        f"the clock of odometry source {name} is {amount} {side} this computer's: its stamps are "
        "fitted to their arrival. Synchronize the clocks (NTP, chrony) for exact times"
    )


def _localization(localization: Values | None, config: Config) -> Iterator[Problem]:
    if localization is None:
        return
    if localization["map"] and not localization.get("confirmed", True) and not _confirms(config):
        yield Problem(
            "pose_unconfirmed",
            "the searched pose stays ambiguous: these settings have no independent search that "
            "confirms it. Give an initial pose, or set localization.alternative_interval, "
            "localization.search_poses and amcl.laser_model_type as config/localization.yaml does",
        )
    if not localization["map"]:
        yield Problem(
            "no_map",
            "localization has no map: set localization.map_path to a saved map, or send one with "
            "`mapperctl set_map`",
        )


def _confirms(config: Config) -> bool:
    """Return whether alternative hypotheses are tried, which confirm a searched pose."""
    ours = config.localization
    is_product = config.amcl.laser_model_type == "likelihood_field_prob"
    return is_product and ours.alternative_interval > 0 and ours.search_poses > 0


def _missing(odometry: Values, config: OdometryFusionConfig) -> Iterator[Problem]:
    """What a pose lacks, of the records that arrive."""
    has = {name for name, one in odometry["quantities"].items() if one["newest_ns"] is not None}
    arriving = " and ".join(sorted(has)) or "nothing usable"
    if "attitude" not in has:
        yield Problem(
            "no_attitude",
            f"the odometry has no attitude, only {arriving}. {NOT_MAPPED}. Add a source of the "
            f"attitude to odometry.sources{_awaited('attitude', odometry, config)}",
        )
    elif not has & {"position", "velocity"} and config.owners.position != FIXED:
        awaited = [_awaited(one, odometry, config) for one in ("position", "velocity")]
        yield Problem(
            "no_position",
            f"the odometry has neither horizontal position nor velocity, only {arriving}. "
            f"{NOT_MAPPED}. Add a DVL or another position to odometry.sources, or map from one "
            f"spot with odometry.owners.position: {FIXED}{''.join(awaited)}",
        )


def _awaited(quantity: str, odometry: Values, config: OdometryFusionConfig) -> str:
    """Why the source that owns a quantity does not provide it, if one is named."""
    owner = getattr(config.owners, quantity)
    if owner in ("", NOBODY, FIXED):
        return ""
    rejected = odometry["sources"].get(owner, {}).get("rejected", {})
    why = f", which sent: {_counts(rejected)}" if rejected else ", which sent none"
    return f"; {quantity} is expected from {owner}{why}"


def recording_problem(recording: Values | None) -> Iterator[Problem]:
    """Yield the problem of a recording that is paused."""
    if recording is not None and recording["state"] == "paused":
        reason = str(recording["reason"] or "the disk cannot be written")
        yield Problem(
            "recording_paused",
            f"recording is paused: {SHORTAGES.get(reason, reason)}. Delete files, or lower "
            "recording.budget",
        )


def lost_bricks(store: Values | None) -> Iterator[Problem]:
    """Yield the problem of a map with damaged bricks.

    Args:
        store: with `bricks_lost`; None without a map file.
    """
    if store is not None and (lost := store["bricks_lost"]):
        yield Problem(
            "bricks_lost",
            f"the map has holes: {lost} damaged bricks of its file are missing, their space is "
            "unknown, not free. A restart of the daemon rebuilds them from its recordings",
        )


def _counts(counts: Values) -> str:
    most = sorted(counts.items(), key=lambda item: -item[1])[:MAX_REASONS]
    return ", ".join(f"{reason} {count}" for reason, count in most)
