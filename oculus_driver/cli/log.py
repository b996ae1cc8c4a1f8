"""`oculus log`: record a sonar within the limits of a disk."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oculus_driver.cli.arguments import (
    add_settings_arguments,
    add_sonar_arguments,
    counter_fields,
    line_of,
    non_negative,
    open_sonar,
    positive,
    settings_of,
)
from oculus_driver.cli.output import Output, run_until_stopped
from oculus_driver.command_line import ExitCode
from oculus_driver.link.state import LinkState

if TYPE_CHECKING:
    import argparse

    from oculus_driver.link.state import LinkStatus
    from oculus_driver.recording import BackgroundLog, LogPolicy, SonarLog
    from oculus_driver.settings import FireSettings
    from oculus_driver.sonar import OculusSonar
    from oculus_driver.stream import MessageBounds

NAME = "log"
HELP = "let a sonar ping and record it: only under water"

_MEGABYTE = 1_000_000
_SECOND_NS = 1_000_000_000
_CHECK_INTERVAL_S = 0.5
_NO_PING_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_sonar_arguments(parser)
    add = parser.add_argument
    add(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("sonar-log"),
        help="folder of the files (default: %(default)s)",
    )
    add("--prefix", default="sonar", help="prefix of the file names (default: %(default)s)")
    add("--duration", metavar="S", type=positive, help="stop after S seconds")
    add(
        "--every",
        metavar="S",
        type=positive,
        default=10.0,
        help="report every S seconds (default: 10)",
    )
    add("--keep-pinging", action="store_true", help="leave the sonar pinging at the end")
    limits = parser.add_argument_group("limits").add_argument
    limits(
        "--file-mb",
        metavar="MB",
        type=positive,
        default=500.0,
        help="size of a file (default: 500)",
    )
    limits("--file-s", metavar="S", type=positive, help="duration of a file (default: no limit)")
    limits(
        "--budget-mb", metavar="MB", type=positive, help="total size; the oldest files are deleted"
    )
    limits(
        "--free-mb",
        metavar="MB",
        type=non_negative,
        default=1000.0,
        help="minimum free space (default: 1000)",
    )
    limits(
        "--sync-s",
        metavar="S",
        type=non_negative,
        default=5.0,
        help="maximum loss in a power failure (default: 5)",
    )
    add_settings_arguments(parser)


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Record until stopped; an empty recording is a failure."""
    output.keep_running = True
    settings = settings_of(args)
    from oculus_driver.recording import SonarLog  # noqa: PLC0415 - slow to import

    log = SonarLog(
        args.out,
        _policy(args),
        prefix=args.prefix,
        monotonic_to_unix_ns=lambda: time.time_ns() - time.monotonic_ns(),
    )
    watch = _LogMonitor(args, output, settings, log)
    watch.check_space()
    run_until_stopped(_log(args, output, settings, watch))
    problem = watch.problem()
    return ExitCode.OK if problem is None else output.failure(problem, ExitCode.FAULT)


async def _log(
    args: argparse.Namespace, output: Output, settings: FireSettings, watch: _LogMonitor
) -> None:
    from oculus_driver.recording import BackgroundLog  # noqa: PLC0415 - slow to import

    log = watch.log
    end: dict[str, Any] = {}
    try:
        async with BackgroundLog(log) as writer:
            tap = _Tap(writer, output)
            sonar = open_sonar(
                args,
                settings,
                keep_pinging=args.keep_pinging,
                on_chunk=tap.take,
                on_status=writer.write_status,
                on_state=tap.link_changed,
            )
            watch.sonar, watch.writer = sonar, writer
            try:
                async with asyncio.timeout(args.duration), sonar, asyncio.TaskGroup() as tasks:
                    tasks.create_task(watch.run())
                    tasks.create_task(_report_periodically(args.every, output, sonar, log))
                    async for _ in sonar.pings():
                        pass  # `tap` has recorded the bytes
            except TimeoutError:
                pass
            finally:
                end = _state_of(log)
    finally:  # the thread that writes has ended: the counters are final
        if watch.sonar is not None:
            _report(output, watch.sonar, log, "end", end)


class _LogMonitor:
    """Reports at once that nothing is recorded, and at the end what is missing.

    Attributes:
        log: the log.
        sonar, writer: the sonar and the thread that writes, None before they are opened.
    """

    def __init__(
        self, args: argparse.Namespace, output: Output, settings: FireSettings, log: SonarLog
    ) -> None:
        self.log = log
        self.sonar: OculusSonar | None = None
        self.writer: BackgroundLog | None = None
        self._expects_pings = not settings.standby
        self._free_mb = args.free_mb
        self._output = output
        self._reported: str | None = None

    def check_space(self) -> None:
        """Report that there is no space before the sonar is opened."""
        shortage = self.log.shortage
        if shortage is not None:
            self._report(self._in_words(shortage))

    async def run(self) -> None:
        """Report each change until cancelled."""
        loop = asyncio.get_running_loop()
        pings, since_s = 0, loop.time()
        while True:
            await asyncio.sleep(_CHECK_INTERVAL_S)
            count = self._pings
            if count != pings:
                pings, since_s = count, loop.time()
            if self.log.state == "paused":
                self._report(self._in_words(self.log.reason or "disk"))
            elif self._expects_pings and loop.time() - since_s > _NO_PING_S:
                self._report(f"no ping for {_NO_PING_S:g} s")
            elif count or not self._expects_pings:
                self._report(None)

    def problem(self) -> str | None:
        """Return what was not recorded, None if everything was."""
        counters = self.log.counters
        if not counters.bytes_written:
            why = f" ({self._reported})" if self._reported else ""
            return f"nothing was recorded{why}; run `oculus doctor`"
        if self._expects_pings and not self._pings:
            return "no ping was recorded; run `oculus doctor`"
        drops = dict(counters.drops)
        if self.writer is not None and self.writer.bytes_dropped:
            drops["disk too slow"] = 1
        dropped = counters.bytes_dropped + (self.writer.bytes_dropped if self.writer else 0)
        return f"{dropped} bytes were not recorded ({', '.join(drops)})" if dropped else None

    @property
    def _pings(self) -> int:
        return 0 if self.sonar is None else self.sonar.counters.pings

    def _report(self, problem: str | None) -> None:
        """Report a problem when it begins, and its end."""
        if problem == self._reported:
            return
        self._reported = problem
        text = "recording" if problem is None else f"NOT RECORDING: {problem}"
        self._output.report({"event": "recording", "problem": problem}, text)

    def _in_words(self, reason: str) -> str:
        words = {
            "free_space": f"less than {self._free_mb:g} MB would stay free on the disk (--free-mb)",
            "budget": "the files of this log fill the budget (--budget-mb)",
        }
        return words.get(reason, reason)


class _Tap:
    """Records the sonar's bytes; a new connection starts with a gap."""

    def __init__(self, writer: BackgroundLog, output: Output) -> None:
        self._writer = writer
        self._output = output
        self._fresh = False

    def take(self, data: bytes, arrival_ns: int, bounds: MessageBounds) -> None:
        """Record bytes."""
        self._writer.write(data, arrival_ns, bounds, gap_before=self._fresh)
        self._fresh = False

    def link_changed(self, link: LinkStatus) -> None:
        """Report the link's state."""
        if link.state == LinkState.CONNECTING:
            self._fresh = True
        fields = {"event": "state", "state": str(link.state), "reason": link.reason}
        self._output.report(fields | {"address": link.address}, f"{link.state}: {link.reason}")


async def _report_periodically(
    every_s: float, output: Output, sonar: OculusSonar, log: SonarLog
) -> None:
    while True:
        await asyncio.sleep(every_s)
        _report(output, sonar, log, "log", _state_of(log))


def _state_of(log: SonarLog) -> dict[str, Any]:
    return {"log_state": log.state, "log_reason": log.reason, "file": log.path}


def _report(
    output: Output, sonar: OculusSonar, log: SonarLog, event: str, state: dict[str, Any]
) -> None:
    counters = log.counters
    fields = {"event": event} | state
    fields |= {name: getattr(counters, name) for name in counters.__slots__}
    fields |= {"sonar": counter_fields(sonar.counters)}
    words = [f"{state['log_state']}: {counters.bytes_written / _MEGABYTE:.1f} MB"]
    words.append(f"{counters.files_opened} files")
    if counters.bytes_dropped:
        words.append(f"{counters.bytes_dropped} bytes not recorded ({state['log_reason']})")
    output.report(fields, f"{line_of(sonar)}; {', '.join(words)}")


def _policy(args: argparse.Namespace) -> LogPolicy:
    from oculus_driver.recording import LogPolicy  # noqa: PLC0415 - slow to import

    return LogPolicy(
        max_file_bytes=round(args.file_mb * _MEGABYTE),
        max_file_ns=None if args.file_s is None else round(args.file_s * _SECOND_NS),
        budget_bytes=None if args.budget_mb is None else round(args.budget_mb * _MEGABYTE),
        free_floor_bytes=round(args.free_mb * _MEGABYTE),
        sync_interval_ns=round(args.sync_s * _SECOND_NS),
    )
