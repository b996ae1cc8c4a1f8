"""`oculus info`: show the content of a recording."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oculus_driver.command_line import ExitCode
from oculus_driver.ping import format_time

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping

    from oculus_driver.cli.output import Output
    from oculus_driver.recording import PingInfo, RecordingInfo

NAME = "info"
HELP = "show the content and the damage of a recording"

_BAR: Final = 40
_MAX_KINDS: Final = 8
_MEGABYTE: Final = 1e6


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("file", metavar="FILE", type=Path, help="recording of any format")
    parser.add_argument("--pings", action="store_true", help="list every ping (always with --json)")


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Read the recording from front to back and report."""
    from oculus_driver.recording import describe, open_recording  # noqa: PLC0415 - slow to import

    with open_recording(args.file) as recording:
        info = describe(recording)
    text = "\n".join(_lines(str(args.file), info, listed=args.pings))
    output.report({"file": args.file, **info.as_json()}, text)
    return ExitCode.OK


def _lines(name: str, info: RecordingInfo, *, listed: bool) -> Iterator[str]:
    yield f"{name}: {info.format}, {info.size_bytes / _MEGABYTE:.3f} MB"
    if info.start_ns is not None and info.end_ns is not None:
        seconds = (info.end_ns - info.start_ns) / 1e9
        start, end = format_time(info.start_ns), format_time(info.end_ns)
        yield f"recorded {start} to {end}, {seconds:.3f} s"
    if re.fullmatch(r"-?\d{1,19}", change_ns := info.metadata.get("clock_change_ns", "")):
        yield f"the host's clock was set by {int(change_ns) / 1e9:+.3f} s before this file"
    if info.damage is not None:
        yield f"damage: {info.damage} ({info.faults} in total)"
    if info.damaged_bytes:
        yield f"fail their checksum: {info.damaged_bytes} bytes"
    if info.link_losses:
        yield f"gaps marked while recording: {info.link_losses} (link lost, or no room)"
    yield f"messages: {info.messages}, valid pings: {info.pings}"
    if info.full_pings:
        yield f"full ping results: {info.full_pings} (not mapped)"
    if info.statuses:
        yield f"statuses: {info.statuses}"
    for kind, count in _kinds(info.ping_list).most_common(_MAX_KINDS):
        yield f"  {count} x {kind}"
    yield (
        f"ids: {info.lost_pings} lost, {info.duplicates} duplicates, {info.restarts} restarts; "
        f"bytes outside messages: {info.bytes_rejected} of {info.bytes_total}"
    )
    yield from _histogram("rejects", info.rejects)
    yield from _histogram("warnings", info.warnings)
    if listed:
        yield from (f"{ping.id:>10}  {_kind(ping)}" for ping in info.ping_list)


def _kinds(pings: list[PingInfo]) -> Counter[str]:
    return Counter(_kind(ping) for ping in pings)


def _kind(ping: PingInfo) -> str:
    frequency = "?" if ping.frequency_hz is None else f"{ping.frequency_hz / 1e6:.3f}"
    shape = f"{ping.rows} rows x {ping.beams} beams, {ping.bits_per_sample} bit"
    return f"{shape}, {ping.range_m:.2f} m, {frequency} MHz"


def _histogram(title: str, counts: Mapping[str, int]) -> Iterator[str]:
    """Yield a line per reason, most frequent first, with a bar in proportion to its share."""
    if not counts:
        yield f"{title}: none"
        return
    yield f"{title}:"
    width = max(len(reason) for reason in counts)
    most = max(counts.values())
    for reason, count in Counter(counts).most_common():
        bar = "#" * max(1, round(_BAR * count / most))
        yield f"  {reason:<{width}}  {count:>8}  {bar}"
