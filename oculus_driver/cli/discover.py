"""`oculus discover`: which sonars are on the network, and what is wrong with them."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import add_status_arguments, positive
from oculus_driver.cli.output import Exit, Say, run_until_stopped
from oculus_driver.discovery.diagnosis import sighting_findings, silence_finding
from oculus_driver.discovery.listener import Discovery, addresses_towards

if TYPE_CHECKING:
    import argparse

    from oculus_driver.discovery.diagnosis import Finding
    from oculus_driver.discovery.state import Sighting

NAME = "discover"
HELP = "list the sonars on the network by their status broadcasts"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what may be said."""
    add = parser.add_argument
    add("--seconds", metavar="S", type=positive, default=3.0, help="how long (default: 3)")
    add("--first", action="store_true", help="stop at the first sonar")
    add_status_arguments(parser)


def run(said: argparse.Namespace, say: Say) -> Exit:
    """Listen, then tell of every sonar; none at all is a fault."""
    found: list[Sighting] = []
    run_until_stopped(_listen(said, found))
    for sighting in found:
        findings = findings_of(sighting)
        facts = sighting.facts() | {"findings": [asdict(finding) for finding in findings]}
        say.report(facts, "\n".join([line_of(sighting), *(f"  {f.text}" for f in findings)]))
    if found:
        return Exit.OK
    return say.failure(silence_finding(said.status_port).text, Exit.FAULT)


async def _listen(said: argparse.Namespace, found: list[Sighting]) -> None:
    async with Discovery(said.status_port, said.listen) as discovery:
        try:
            async with asyncio.timeout(said.seconds):
                async for _ in discovery.sightings():
                    if said.first:
                        break
        except TimeoutError:
            pass
        found += discovery.present()


def findings_of(sighting: Sighting) -> list[Finding]:
    """Return what is wrong with a sonar, seen from this host."""
    return sighting_findings(sighting, addresses_towards(sighting.address))


def line_of(sighting: Sighting) -> str:
    """Return the sonar in one line."""
    status = sighting.status
    facts = sighting.facts()
    words = [
        f"{sighting.address:<15}",
        f"{sighting.model.name}",
        f"serial {status.device_id}",
        f"{status.master_state}",
        f"firmware {facts['firmware']['arm0']}",
    ]
    if facts["temperature_c"] is not None:
        words.append(f"{facts['temperature_c']:.1f} °C")
    words.append(f"held by {facts['held_by']}" if status.busy else "free")
    return "  ".join(words)
