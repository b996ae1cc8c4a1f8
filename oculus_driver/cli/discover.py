"""`oculus discover`: which sonars are on the network, and what is wrong with them."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import add_status_arguments, positive
from oculus_driver.cli.output import Exit, Output, run_until_stopped
from oculus_driver.discovery.diagnosis import discovery_findings, silence_finding
from oculus_driver.discovery.listener import Discovery, addresses_towards

if TYPE_CHECKING:
    import argparse

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import DiscoveredSonar

NAME = "discover"
HELP = "list the sonars on the network by their status broadcasts"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add("--seconds", metavar="S", type=positive, default=3.0, help="how long (default: 3)")
    add("--first", action="store_true", help="stop at the first sonar")
    add_status_arguments(parser)


def run(args: argparse.Namespace, output: Output) -> Exit:
    """Listen, then tell of every sonar; none at all is a fault."""
    found: list[DiscoveredSonar] = []
    run_until_stopped(_listen(args, found))
    for sonar in found:
        findings = sonar_findings(sonar)
        fields = sonar.snapshot() | {"findings": [asdict(finding) for finding in findings]}
        output.report(fields, "\n".join([line_of(sonar), *(f"  {f.text}" for f in findings)]))
    if found:
        return Exit.OK
    return output.failure(silence_finding(args.status_port).text, Exit.FAULT)


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
    """Return what is wrong with a sonar, seen from this host."""
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
    words.append(f"held by {fields['held_by']}" if status.busy else "free")
    return "  ".join(words)
