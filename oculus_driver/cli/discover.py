"""`oculus discover`: list the sonars on the network and their problems."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import add_status_arguments, positive
from oculus_driver.cli.output import Output, run_until_stopped
from oculus_driver.command_line import ExitCode
from oculus_driver.discovery.diagnosis import discovery_findings, silence_finding
from oculus_driver.discovery.listener import Discovery, addresses_towards

if TYPE_CHECKING:
    import argparse

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import DiscoveredSonar

NAME = "discover"
HELP = "list the sonars on the network"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("--seconds", metavar="S", type=positive, default=3.0, help="time to wait (default: 3)")
    add("--first", action="store_true", help="stop after the first sonar")
    add_status_arguments(parser)


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Listen, then report every sonar; none at all is a failure."""
    found: list[DiscoveredSonar] = []
    run_until_stopped(_listen(args, found))
    for sonar in found:
        findings = sonar_findings(sonar)
        fields = sonar.snapshot() | {"findings": [asdict(finding) for finding in findings]}
        output.report(fields, "\n".join([line_of(sonar), *(f"  {f.text}" for f in findings)]))
    if found:
        return ExitCode.OK
    return output.failure(silence_finding(args.status_port).text, ExitCode.FAULT)


async def _listen(args: argparse.Namespace, found: list[DiscoveredSonar]) -> None:
    async with Discovery(args.status_port, args.listen) as discovery:
        try:
            async with asyncio.timeout(args.seconds):
                async for _ in discovery.updates():
                    if args.first:
                        break
        except TimeoutError:
            pass
        found += discovery.present()


def sonar_findings(sonar: DiscoveredSonar) -> list[Finding]:
    """Return the problems of a sonar, seen from this host."""
    return discovery_findings(sonar, addresses_towards(sonar.address))


def line_of(sonar: DiscoveredSonar) -> str:
    """Return the sonar in one line."""
    status = sonar.status
    fields = sonar.snapshot()
    words = [
        f"{sonar.address:<15}",
        f"{sonar.model.name}",
        f"serial {status.device_id}",
        f"{status.master_state}",
        f"firmware {fields['firmware']['arm0']}",
    ]
    if fields["temperature_c"] is not None:
        words.append(f"{fields['temperature_c']:.1f} °C")
    words.append(f"in use by {fields['held_by']}" if status.busy else "free")
    return "  ".join(words)
