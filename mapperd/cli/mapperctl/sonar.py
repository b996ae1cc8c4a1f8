"""`mapperctl sonar`: show and change the settings of the sonar while it maps."""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from mapperd.cli.mapperctl.connection import (
    ControlConnection,
    CtlError,
    DaemonTarget,
    plain,
)
from mapperd.config.catalog import parameters
from mapperd.config.loader import YamlProblem, parse_yaml
from mapperd.errors import ConfigError
from oculus_driver.command_line import ExitCode, did_you_mean

__all__ = ["add_sonar", "run_sonar"]

OPTIONS: Mapping[str, str] = MappingProxyType(
    {
        "range": "device.range",
        "gain": "device.gain",
        "gain-assist": "device.gain_assist",
        "gamma": "device.gamma",
        "mode": "device.mode",
        "ping-rate": "device.ping_rate",
        "beams": "device.beams",
        "bits": "device.bits_per_sample",
        "salinity": "water.salinity",
        "temperature": "water.temperature",
        "speed-of-sound": "water.speed_of_sound",
        "threshold": "filtering.intensity_threshold",
    }
)
"""Setting by option."""

ANSWER_TIMEOUT_S = 30.0
CONFIRM_TIMEOUT_S = 25.0
"""The daemon reports a confirmation, or that there is none, within 20 s."""

POLL_INTERVAL_S = 0.1

ACTIONS = ("set", "standby", "live")
NAMES = (*OPTIONS.values(), "device.standby")


def add_sonar(command: argparse.ArgumentParser) -> None:
    """Add the arguments of `sonar`."""
    add = command.add_argument
    add(
        "action",
        metavar="ACTION",
        nargs="?",
        type=_action,
        help="set (with options), standby (stop pinging), live (ping again); default: show",
    )
    for option, name in OPTIONS.items():
        fact = parameters()[name]
        add(
            f"--{option}",
            metavar="X",
            dest=name,
            type=_value,
            help=f"{fact.description.rstrip('.')}: {fact.allowed}".replace("%", "%%"),
        )
    add("--no-wait", action="store_true", help="do not wait until a ping shows the settings")


def run_sonar(args: argparse.Namespace, target: DaemonTarget) -> Iterator[str]:
    """Do the command; yields what there is to print.

    Raises:
        CtlError: the settings are refused, or the sonar does not confirm them.
    """
    changes = _changes(args)
    with ControlConnection(target, ANSWER_TIMEOUT_S) as daemon:
        if not changes:
            yield from _shown(args, daemon)
            return
        since = _newest(daemon)
        result = daemon.ask("set", changes=changes)
        for name, (before, after) in result["changed"].items():
            yield (
                json.dumps({"name": name, "before": before, "after": after})
                if args.json
                else f"{name}: {json.dumps(before)} is now {json.dumps(after)}"
            )
        if not result["changed"] and not args.json:
            yield "nothing changed"
        sent = [name for name in result["changed"] if not name.startswith("filtering.")]
        if sent and not args.no_wait:
            yield from _confirmed(args, daemon, since)


def _changes(args: argparse.Namespace) -> dict[str, Any]:
    given = {name: getattr(args, name) for name in OPTIONS.values()}
    changes = {name: value for name, value in given.items() if value is not None}
    if args.action == "set" and not changes:
        options = ", ".join(f"--{option}" for option in OPTIONS)
        raise CtlError(f"sonar set needs an option: {options}", ExitCode.USAGE)
    if changes and args.action != "set":
        raise CtlError("options change settings: mapperctl sonar set ...", ExitCode.USAGE)
    if args.action in ("standby", "live"):
        return {"device.standby": args.action == "standby"}
    return changes


def _shown(args: argparse.Namespace, daemon: ControlConnection) -> Iterator[str]:
    sonar = daemon.ask("status")["sonar"]
    facts = daemon.ask("params", names=list(NAMES))
    if args.json:
        yield json.dumps({"settings": {n: f["value"] for n, f in facts.items()}, "sonar": sonar})
        return
    yield plain(_headline(sonar))
    for name in NAMES:
        fact = facts.get(name)
        if fact is not None:
            yield plain(f"{name:<29} {_with_unit(fact):<12} {_note(name, sonar)}".rstrip())
    for difference in sonar.get("differences") or ():
        yield plain(f"the last ping differs: {difference}")


def _headline(sonar: Mapping[str, Any]) -> str:
    words = [str(sonar.get("model") or "sonar"), str(sonar.get("state")), str(sonar.get("reason"))]
    rate = sonar.get("ping_rate_hz")
    if rate is not None and not (sonar.get("requested") or {}).get("standby"):
        words.append(f"{rate:.1f} pings/s")
    return ", ".join(words)


def _note(name: str, sonar: Mapping[str, Any]) -> str:
    limit_m = sonar.get("model_range_m")
    notes: Mapping[str, Callable[[], str]] = {
        "device.range": lambda: f"at most {limit_m:g} m in this mode" if limit_m else "",
        "water.speed_of_sound": lambda: (
            f"the sonar uses {sonar['speed_of_sound_mps']:.1f} m/s"
            if sonar.get("speed_of_sound_mps")
            else ""
        ),
        "water.temperature": lambda: (
            f"the sonar measures {sonar['temperature_c']:.1f} °C"
            if sonar.get("temperature_c") is not None
            else ""
        ),
    }
    return notes.get(name, lambda: "")()


def _with_unit(fact: Mapping[str, Any]) -> str:
    unit = str(fact["unit"])
    number = isinstance(fact["value"], int | float) and not isinstance(fact["value"], bool)
    measure = number and unit != "" and not unit[:1].isdigit()
    value = fact["value"] if isinstance(fact["value"], str) else json.dumps(fact["value"])
    return f"{value} {unit}" if measure else value


def _newest(daemon: ControlConnection) -> int:
    """Return the number of the newest event."""
    since, more = 0, True
    while more:
        batch = daemon.ask("events", since=since)
        more, events = batch["more"], batch["events"]
        since = events[-1]["number"] if events else since
    return since


def _confirmed(args: argparse.Namespace, daemon: ControlConnection, since: int) -> Iterator[str]:
    """Wait for the daemon's event about the change."""
    until_s = time.monotonic() + CONFIRM_TIMEOUT_S
    while time.monotonic() < until_s:
        for event in daemon.ask("events", since=since)["events"]:
            since = event["number"]
            if event["code"] != "sonar_settings":
                continue
            if not event["facts"]["confirmed"]:
                raise CtlError(str(event["text"]), ExitCode.TRY_AGAIN)
            yield json.dumps(event) if args.json else plain(str(event["text"]))
            return
        daemon.wait(POLL_INTERVAL_S)
    raise CtlError("the sonar has not confirmed the settings", ExitCode.TRY_AGAIN)


def _action(text: str) -> str:
    if text not in ACTIONS:
        hint = did_you_mean(text, ACTIONS) or f"; allowed: {', '.join(ACTIONS)}"
        raise argparse.ArgumentTypeError(f"there is no action {text!r}{hint}")
    return text


def _value(text: str) -> object:
    try:
        return parse_yaml(text)
    except (YamlProblem, ConfigError) as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from None
