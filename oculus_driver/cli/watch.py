"""`oculus watch`: report what sonars on the network do; with --ping their pings, too."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import (
    add_settings_arguments,
    add_sonar_arguments,
    counter_fields,
    line_of,
    open_sonar,
    positive,
    settings_of,
)
from oculus_driver.cli.discover import line_of as sighting_line
from oculus_driver.cli.discover import sonar_findings
from oculus_driver.cli.output import Output, run_until_stopped
from oculus_driver.command_line import ExitCode
from oculus_driver.discovery.listener import Discovery

if TYPE_CHECKING:
    import argparse

    from oculus_driver.discovery.state import DiscoveredSonar
    from oculus_driver.link.state import LinkStatus
    from oculus_driver.ping import Ping
    from oculus_driver.sonar import OculusSonar

NAME = "watch"
HELP = "report the statuses of sonars, or with --ping the link and the pings of one"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_sonar_arguments(parser)
    add = parser.add_argument
    add("--ping", action="store_true", help="connect and request pings: only under water")
    add(
        "--every",
        metavar="S",
        type=positive,
        default=1.0,
        help="report every S seconds (default: 1)",
    )
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add_settings_arguments(parser)


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Watch until stopped."""
    if args.ping:
        watch = _PingWatch(args.every, output)
        run_until_stopped(_watch_pings(args, output, watch), args.duration)
        return (
            ExitCode.OK
            if watch.last is not None
            else output.failure("no ping arrived", ExitCode.FAULT)
        )
    reported: dict[tuple[int, int], frozenset[str]] = {}
    run_until_stopped(_watch_statuses(args, output, reported), args.duration)
    return ExitCode.OK if reported else output.failure("no sonar was discovered", ExitCode.FAULT)


async def _watch_statuses(
    args: argparse.Namespace, output: Output, reported: dict[tuple[int, int], frozenset[str]]
) -> None:
    """Report each status, and its problems when they are new."""
    async with Discovery(args.status_port, args.listen) as discovery:
        async for sonar in discovery.updates():
            if _is_selected(args, sonar):
                findings = sonar_findings(sonar)
                before = reported.get(sonar.key, frozenset())
                reported[sonar.key] = frozenset(finding.code for finding in findings)
                new = [finding.text for finding in findings if finding.code not in before]
                fields = sonar.snapshot() | {"findings": sorted(reported[sonar.key])}
                output.report(fields, "\n".join([sighting_line(sonar), *(f"  {t}" for t in new)]))


def _is_selected(args: argparse.Namespace, sonar: DiscoveredSonar) -> bool:
    by_address = args.host in (None, sonar.address)
    return by_address and args.serial in (None, sonar.status.device_id)


async def _watch_pings(args: argparse.Namespace, output: Output, watch: _PingWatch) -> None:
    def report_state(link: LinkStatus) -> None:
        fields = {"event": "state", "state": str(link.state), "reason": link.reason}
        output.report(fields | {"address": link.address}, f"{link.state}: {link.reason}")

    async with (
        open_sonar(args, settings_of(args), on_state=report_state) as sonar,
        asyncio.TaskGroup() as tasks,
    ):
        tasks.create_task(watch.report_periodically(sonar))
        async for ping in sonar.pings():
            watch.last = ping


class _PingWatch:
    """Reports the pings periodically."""

    def __init__(self, every_s: float, output: Output) -> None:
        self.last: Ping | None = None
        self._every_s = every_s
        self._output = output

    async def report_periodically(self, sonar: OculusSonar) -> None:
        """Report until cancelled."""
        before = 0
        while True:
            await asyncio.sleep(self._every_s)
            pings = sonar.counters.pings
            self._report(sonar, (pings - before) / self._every_s)
            before = pings

    def _report(self, sonar: OculusSonar, rate_hz: float) -> None:
        fields = {"event": "pings", "state": str(sonar.state), "rate_hz": rate_hz}
        fields |= counter_fields(sonar.counters)
        text = f"{line_of(sonar)}, {rate_hz:.1f} Hz"
        ping = self.last
        if ping is not None:
            fields |= {"ping_id": ping.ping_id, "rows": ping.rows, "beams": ping.beams}
            fields |= {"range_m": ping.max_range_m, "temperature_c": ping.temperature_c}
            text += f", {ping.rows} x {ping.beams} to {ping.max_range_m:.2f} m"
        text += "".join(f"\n  {difference}" for difference in sonar.changed)
        self._output.report(fields, text)
