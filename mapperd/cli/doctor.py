"""`mapperd doctor`: each link from its address to its poses; the first layer that fails."""

import argparse
import asyncio
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mapperd import __version__
from mapperd.cli.mapperctl.connection import ControlConnection, CtlError, DaemonTarget
from mapperd.cli.mapperctl.views import status_lines
from mapperd.config.layers import load_settings
from mapperd.config.odometry import parse_address
from mapperd.config.paths import socket_places
from mapperd.config.tree import Config
from mapperd.daemon.doctor import LinkEvidence, judge_link
from mapperd.errors import ConfigError, Reject
from mapperd.odometry.bridge import OdometryBridge
from mapperd.odometry.formats import check_levelling, make_decoder
from mapperd.odometry.links import OdometryLink
from oculus_driver.command_line import CommandParser, ExitCode
from oculus_driver.discovery.probe import Layer, ProbeOptions, evaluate, probe

__all__ = ["doctor", "doctor_parser"]

MARKS = {"ok": "ok  ", "doubtful": "?   ", "failed": "FAIL", "not tested": "-   "}
ANSWER_TIMEOUT_S = 5.0
MAX_SECONDS = 3600.0
BACK_S = 0.2
"""How long before now a pose is asked for: the newest record is that old at most."""


def doctor(argv: Sequence[str]) -> int:
    """Run `mapperd doctor`; exit code 0 where every link is well, 1 where one is not."""
    args = doctor_parser().parse_args(argv)
    try:
        layered = load_settings([] if args.config is None else [args.config], os.environ)
        check_levelling(layered.config)
    except ConfigError as error:
        print(f"mapperd: {error}", file=sys.stderr)  # noqa: T201 a command speaks
        return ExitCode.BAD_CONFIG
    if layered.notice:
        print(f"mapperd: {layered.notice}", file=sys.stderr)  # noqa: T201
    try:
        if (asked := _asked(layered.config, args.seconds)) is not None:
            return _judged(*asked, as_json=args.json)
        found = asyncio.run(_examined(layered.config, args.seconds, ping=args.ping))
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    failed = [
        name for name, layers in found.items() if any(layer.verdict == "failed" for layer in layers)
    ]
    if args.json:
        facts = {name: [asdict(layer) for layer in layers] for name, layers in found.items()}
        print(json.dumps({"links": facts, "failed": failed}))  # noqa: T201
    else:
        print("\n".join(_lines(found)))  # noqa: T201
    return ExitCode.FAULT if failed else 0


def _asked(config: Config, seconds: float) -> tuple[Path, dict[str, Any], dict[str, Any]] | None:
    """Ask a running daemon, which holds the links, for its status twice; None without one."""
    for path in socket_places(config, os.environ):
        try:
            with ControlConnection(DaemonTarget(path), ANSWER_TIMEOUT_S) as daemon:
                before = daemon.ask("status")
                daemon.wait(seconds)
                return path, before, daemon.ask("status")
        except CtlError:
            continue
    return None


def _judged(path: Path, before: dict[str, Any], status: dict[str, Any], *, as_json: bool) -> int:
    problems = status.get("problems") or []
    if as_json:
        failed = [one["code"] for one in problems]
        facts = {"daemon": str(path), "problems": problems, "failed": failed, "status": status}
        print(json.dumps(facts))  # noqa: T201
    else:
        print(f"the daemon at {path} holds the links; it reports:")  # noqa: T201
        print("\n".join(status_lines(status, before)))  # noqa: T201
        if not problems:
            print("no problems")  # noqa: T201
    return ExitCode.FAULT if problems else 0


def doctor_parser() -> CommandParser:
    """Return the parser of `mapperd doctor`."""
    parser = CommandParser(
        "mapperd doctor",
        description="Watch every link for a while; name the first layer that fails and what to do. "
        "A running daemon holds the links; then doctor asks the daemon.",
        epilog="exit codes: 0 all links work; 1 a link fails; 78 invalid settings; 130 interrupted",
    )
    add = parser.add_argument
    add(
        "--config",
        metavar="YAML",
        type=Path,
        help="settings file; overrides all others (docs/reference/configuration.md)",
    )
    add("--seconds", metavar="S", type=_seconds, default=5.0, help="time to watch (default: 5)")
    add("--ping", action="store_true", help="ask the sonar for pings: only under water")
    add("--json", action="store_true", help="print one JSON object")
    add("--version", action="version", version=f"mapperd {__version__}")
    return parser


def _seconds(text: str) -> float:
    seconds = float(text)
    if not MAX_SECONDS >= seconds > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: give more than 0 and at most {MAX_SECONDS:g}")
    return seconds


async def _examined(config: Config, seconds: float, *, ping: bool) -> dict[str, list[Layer]]:
    """Watch the sonar and the odometry at the same time."""
    device = config.device
    sonar, links = await asyncio.gather(
        probe(ProbeOptions(device.address or None, device.port, seconds, ping)),
        _watched(config, seconds),
    )
    return {"sonar": evaluate(sonar), **{one.name: judge_link(one) for one in links}}


async def _watched(config: Config, seconds: float) -> list[LinkEvidence]:
    bridge = OdometryBridge(config)
    missing: dict[str, str] = {}
    links, tasks = [], []
    for source in config.odometry.sources:
        address = parse_address(source.link)
        try:
            make_decoder(source)
        except ConfigError as error:
            missing[source.name] = str(error)

        def take(data: bytes, at_ns: int, *, gap: bool, name: str = source.name) -> None:
            if name not in missing:
                bridge.feed(name, data, at_ns, gap_before=gap)

        link = OdometryLink(source.name, address, take, time.time_ns)
        links.append(link)
        tasks.append(asyncio.create_task(link.run()))
    await asyncio.wait(tasks, timeout=seconds)
    statuses = {link.name: link.status for link in links}
    for task in tasks:
        task.cancel()
    ends = await asyncio.gather(*tasks, return_exceptions=True)
    for link, end in zip(links, ends, strict=True):
        if isinstance(end, ConfigError):
            missing[link.name] = str(end)
    return [
        LinkEvidence(
            link.name,
            link.address,
            source.format,
            statuses[link.name],
            seconds,
            None if (decoder := bridge.decoder_of(link.name)) is None else decoder.counters,
            bridge.fusion.rejects.get(link.name, Counter()),
            _owned(bridge.status(), link.name),
            _fault(bridge, config.time_sync.policy),
            missing.get(link.name),
        )
        for link, source in zip(links, config.odometry.sources, strict=True)
    ]


def _owned(status: dict[str, Any], name: str) -> tuple[str, ...]:
    return tuple(quantity for quantity, one in status["quantities"].items() if one["owner"] == name)


def _fault(bridge: OdometryBridge, policy: str) -> str | None:
    """Why there is no pose now; None where there is one."""
    newest = [
        one["newest_ns"]
        for one in bridge.fusion.status()["quantities"].values()
        if one["newest_ns"] is not None
    ]
    if not newest:
        return "no record was used"
    # The newest record is all that `latest` knows: nothing before it can be asked for.
    at_ns = max(newest) if policy == "latest" else min(newest) - round(BACK_S * 1e9)
    pose = bridge.fusion.at(at_ns)
    return pose.detail if isinstance(pose, Reject) else None


def _lines(found: dict[str, list[Layer]]) -> list[str]:
    lines = []
    for name, layers in found.items():
        lines.append(name)
        lines += [f"  {MARKS[layer.verdict]} {layer.name:<8} {layer.text}" for layer in layers]
    return lines
