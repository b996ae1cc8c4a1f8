"""`oculus watch`: what sonars on the network do, line by line; with --ping their pings too."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import (
    add_settings_arguments,
    add_sonar_arguments,
    facts_of,
    line_of,
    positive,
    settings_of,
    sonar_of,
)
from oculus_driver.cli.discover import findings_of
from oculus_driver.cli.discover import line_of as sighting_line
from oculus_driver.cli.output import Exit, Say, run_until_stopped
from oculus_driver.discovery.listener import Discovery

if TYPE_CHECKING:
    import argparse

    from oculus_driver.discovery.state import Sighting
    from oculus_driver.link.state import LinkStatus
    from oculus_driver.ping import Ping
    from oculus_driver.sonar import OculusSonar

NAME = "watch"
HELP = "tell what sonars do: their statuses, or with --ping the link and the pings of one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what may be said."""
    add_sonar_arguments(parser)
    add = parser.add_argument
    add("--ping", action="store_true", help="connect and let it ping: only under water")
    add("--every", metavar="S", type=positive, default=1.0, help="a line every S seconds")
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add_settings_arguments(parser)


def run(said: argparse.Namespace, say: Say) -> Exit:
    """Watch until somebody stops it."""
    if said.ping:
        watch = _PingWatch(said.every, say)
        run_until_stopped(_watch_pings(said, say, watch), said.duration)
        return Exit.OK if watch.last is not None else say.failure("no ping came", Exit.FAULT)
    told: dict[tuple[int, int], frozenset[str]] = {}
    run_until_stopped(_watch_statuses(said, say, told), said.duration)
    return Exit.OK if told else say.failure("no sonar was heard", Exit.FAULT)


async def _watch_statuses(
    said: argparse.Namespace, say: Say, told: dict[tuple[int, int], frozenset[str]]
) -> None:
    """Tell of each status; what is wrong only when it is new."""
    async with Discovery(said.status_port, said.listen) as discovery:
        async for sighting in discovery.sightings():
            if _meant(said, sighting):
                findings = findings_of(sighting)
                before = told.get(sighting.key, frozenset())
                told[sighting.key] = frozenset(finding.code for finding in findings)
                new = [finding.text for finding in findings if finding.code not in before]
                facts = sighting.facts() | {"findings": sorted(told[sighting.key])}
                say.report(facts, "\n".join([sighting_line(sighting), *(f"  {t}" for t in new)]))


def _meant(said: argparse.Namespace, sighting: Sighting) -> bool:
    by_address = said.host in (None, sighting.address)
    return by_address and said.serial in (None, sighting.status.device_id)


async def _watch_pings(said: argparse.Namespace, say: Say, watch: _PingWatch) -> None:
    def tell_state(link: LinkStatus) -> None:
        facts = {"event": "state", "state": str(link.state), "reason": link.reason}
        say.report(facts | {"address": link.address}, f"{link.state}: {link.reason}")

    async with (
        sonar_of(said, settings_of(said), on_state=tell_state) as sonar,
        asyncio.TaskGroup() as tasks,
    ):
        tasks.create_task(watch.tell_regularly(sonar))
        async for ping in sonar.pings():
            watch.last = ping


class _PingWatch:
    """Says every so often how the pings come."""

    def __init__(self, every_s: float, say: Say) -> None:
        self.last: Ping | None = None
        self._every_s = every_s
        self._say = say

    async def tell_regularly(self, sonar: OculusSonar) -> None:
        """Go on until cancelled."""
        before = 0
        while True:
            await asyncio.sleep(self._every_s)
            pings = sonar.counters.pings
            self._tell(sonar, (pings - before) / self._every_s)
            before = pings

    def _tell(self, sonar: OculusSonar, rate_hz: float) -> None:
        facts = {"event": "pings", "state": str(sonar.state), "rate_hz": rate_hz}
        facts |= facts_of(sonar.counters)
        text = f"{line_of(sonar)}, {rate_hz:.1f} Hz"
        ping = self.last
        if ping is not None:
            facts |= {"ping_id": ping.ping_id, "rows": ping.rows, "beams": ping.beams}
            facts |= {"range_m": ping.max_range_m, "temperature_c": ping.temperature_c}
            text += f", {ping.rows} x {ping.beams} to {ping.max_range_m:.2f} m"
        text += "".join(f"\n  {difference}" for difference in sonar.changed)
        self._say.report(facts, text)
