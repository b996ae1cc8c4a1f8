"""`oculus convert`: convert a recording to another format."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final

from oculus_driver.command_line import ExitCode

if TYPE_CHECKING:
    import argparse

    from oculus_driver.cli.output import Output

NAME = "convert"
HELP = "convert a recording to another format"

FORMATS: Final = {
    ".mcap": "mcap",
    ".raw": "oculus-raw",
    ".dat": "oculus-raw",
    ".oculus": "oculus-log",
    ".pcap": "pcap",
}
"""Format by suffix of the target file."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="recording of any format")
    add(
        "out",
        metavar="OUT",
        type=Path,
        help=f"target, ending in {', '.join(FORMATS)}, or use --format",
    )
    add(
        "--format",
        choices=sorted({*FORMATS.values()}),
        help="target format, regardless of the suffix",
    )
    add("--allow-damaged", action="store_true", help="also write data that fail their checksum")
    add("--overwrite", action="store_true", help="replace an existing OUT")


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Convert, and report what the target format cannot represent."""
    from oculus_driver.recording.convert import convert  # noqa: PLC0415 - slow to import

    target_format = args.format or FORMATS.get(args.out.suffix.lower())
    if target_format is None:
        text = f"{args.out}: unknown format; use one of the suffixes {', '.join(FORMATS)}"
        return output.failure(text, ExitCode.USAGE)
    done = convert(
        args.file,
        args.out,
        target_format,
        overwrite=args.overwrite,
        allow_damaged=args.allow_damaged,
    )
    lines = [f"{args.out}: {done.target_format}, {done.size_bytes} bytes, {done.chunks} chunks"]
    lines += [f"left out: {count} bytes, {reason}" for reason, count in done.left_out.items()]
    if done.stamps_lost:
        lines.append(
            f"left out: {done.stamps_lost} arrival stamps, which the format cannot represent"
        )
    if done.damage is not None:
        lines.append(f"the source is damaged: {done.damage}")
    output.report({"file": args.file, "out": args.out, **asdict(done)}, "\n".join(lines))
    return ExitCode.BAD_DATA if "checksum" in done.left_out else ExitCode.OK
