"""`oculus doctor`: find the first layer between this host and a sonar's pings that fails."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING, Final

from oculus_driver.cli.arguments import add_status_arguments, address, port, positive
from oculus_driver.command_line import ExitCode
from oculus_driver.discovery.probe import Layer, ProbeOptions, evaluate, first_failure, probe
from oculus_driver.wire import TCP_PORT

if TYPE_CHECKING:
    import argparse

    from oculus_driver.cli.output import Output


NAME = "doctor"
HELP = "check address, port, bytes, frames and pings; report the first failure and its remedy"

_MARKS: Final = {"ok": "ok  ", "doubtful": "?   ", "failed": "FAIL", "not tested": "-   "}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add(
        "host",
        metavar="ADDRESS",
        nargs="?",
        type=address,
        help="address of the sonar (default: the first one discovered)",
    )
    add("--port", type=port, default=TCP_PORT, help="TCP port (default: %(default)s)")
    add(
        "--seconds",
        metavar="S",
        type=positive,
        default=4.0,
        help="duration of each step (default: 4)",
    )
    add("--ping", action="store_true", help="request pings, then standby: only under water")
    add(
        "--version",
        type=int,
        choices=(1, 2),
        default=2,
        help="version of the fire messages (default: 2)",
    )
    add_status_arguments(parser)


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Probe, evaluate, report."""
    result = asyncio.run(probe(_options(args)))
    layers = evaluate(result)
    failure = first_failure(layers)
    fields = {
        "address": result.address,
        "layers": [asdict(layer) for layer in layers],
        "first_failure": None if failure is None else failure.name,
        "findings": [asdict(finding) for finding in result.findings],
    }
    notes = [f"note: {finding.text}" for finding in result.findings]
    output.report(fields, "\n".join([*map(_line, layers), *notes]))
    return ExitCode.OK if failure is None else ExitCode.FAULT


def _line(layer: Layer) -> str:
    return f"{_MARKS[layer.verdict]} {layer.name:<8} {layer.text}"


def _options(args: argparse.Namespace) -> ProbeOptions:
    return ProbeOptions(
        args.host,
        args.port,
        args.seconds,
        args.ping,
        args.version,
        args.status_port,
        args.listen,
    )
