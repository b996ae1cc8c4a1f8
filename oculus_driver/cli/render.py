"""`oculus render`: draw pings of a recording as fan images or a video."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from oculus_driver.cli.arguments import count, non_negative_int, positive
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import ExtraMissingError, OculusError, missing_extra
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.wire import MessageId

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from oculus_driver.cli.output import Output
    from oculus_driver.recording import Recording
    from oculus_driver.render import Painter
    from oculus_driver.render.files import FrameSink
    from oculus_driver.stream import Message


NAME = "render"
HELP = "draw the pings of a recording as fan images (PNG) or a video (MP4)"

DEFAULT_RATE_HZ = 10.0
_RATE_LIMITS_HZ = (1.0, 60.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="recording of any format")
    add(
        "out",
        metavar="OUT",
        type=Path,
        help="NAME.mp4 for a video, NAME.png for one ping, else a folder for PNG files",
    )
    add(
        "--first",
        metavar="N",
        type=non_negative_int,
        default=0,
        help="start with ping N, counted from 0",
    )
    add("--every", metavar="N", type=count, default=1, help="draw every Nth ping")
    add("--limit", metavar="N", type=count, help="draw at most N pings")
    add("--ping", metavar="ID", type=non_negative_int, help="only pings with this id")
    add(
        "--height",
        metavar="PX",
        type=count,
        default=900,
        help="height of the image in pixels (default: 900)",
    )
    add("--colours", choices=("inferno", "viridis", "grey"), default="inferno")
    add("--gamma", type=positive, default=0.7, help="display exponent (default: %(default)s)")
    add("--keep-gains", action="store_true", help="do not divide by the rows' gain words")
    add(
        "--detections",
        metavar="FACTOR",
        type=positive,
        nargs="?",
        const=7.0,
        default=0.0,
        help="mark echoes: samples above FACTOR times the noise at their range (default: 7)",
    )
    add("--bare", action="store_true", help="without rings, spokes and labels")
    add(
        "--fps",
        metavar="HZ",
        type=positive,
        help="frame rate of a video (default: as recorded, else 10)",
    )


def run(args: argparse.Namespace, output: Output) -> ExitCode:
    """Draw, and report the written files."""
    from oculus_driver.recording import open_recording  # noqa: PLC0415 - slow to import

    painter = _painter(args)
    single = args.out.suffix.lower() == ".png"
    choice = Choice(args.first, args.every, 1 if single else args.limit, args.ping)
    with open_recording(args.file) as recording:
        rate_hz = args.fps or _rate_hz(recording, args.every)
        files, drawn = _draw(args.out, painter, choice, recording, rate_hz)
    if not drawn:
        raise OculusError(f"{args.file}: no ping to draw; run `oculus info {args.file}`")
    fields = {"files": files, "pings": drawn, "rejects": dict(choice.rejects)}
    where = files[0] if len(files) == 1 else args.out
    output.report(fields, f"{drawn} pings drawn: {where}")
    return ExitCode.OK


def _painter(args: argparse.Namespace) -> Painter:
    try:
        from oculus_driver.render import Painter, Style  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ExtraMissingError(f"images: {missing_extra('OpenCV', 'render')}") from error
    return Painter(
        Style(
            args.height,
            args.colours,
            args.gamma,
            not args.keep_gains,
            labels=not args.bare,
            echo_factor=args.detections,
        )
    )


def _draw(
    out: Path, painter: Painter, choice: Choice, recording: Recording, rate_hz: float
) -> tuple[list[Path], int]:
    """Return the written files and the number of pings in them."""
    drawn = 0
    with _sink(out, rate_hz) as sink:
        for ping in choice.of(recording):
            sink.add(painter.paint(ping), f"ping_{ping.ping_id}")
            drawn += 1
    return (sink.files if drawn else []), drawn


def _sink(out: Path, rate_hz: float) -> FrameSink:
    from oculus_driver.render.files import PngFile, PngFolder, VideoFile  # noqa: PLC0415 - an extra

    match out.suffix.lower():
        case ".mp4":
            return VideoFile(out, rate_hz)
        case ".png":
            return PngFile(out)
    return PngFolder(out)


def _rate_hz(recording: Recording, every: int) -> float:
    """Return the frame rate of the recording, limited to useful rates of a video."""
    times: list[int] = []
    for ping in Choice(limit=50).of(recording):
        times += [] if ping.arrival_ns is None else [ping.arrival_ns]
    if len(times) < 2 or times[-1] <= times[0]:  # noqa: PLR2004 - an interval has two ends
        return DEFAULT_RATE_HZ
    rate_hz = (len(times) - 1) * 1e9 / (times[-1] - times[0]) / every
    return min(max(rate_hz, _RATE_LIMITS_HZ[0]), _RATE_LIMITS_HZ[1])


@dataclass(slots=True)
class Choice:
    """Selection of pings of a recording, and counters of unusable ones.

    Attributes:
        first: first ping, counted from 0.
        step: every how many pings.
        limit: maximum number of pings, None: all.
        ping_id: only pings with this id.
        rejects: unusable pings by reason.
    """

    first: int = 0
    step: int = 1
    limit: int | None = None
    ping_id: int | None = None
    rejects: Counter[str] = field(default_factory=Counter)

    def of(self, recording: Recording) -> Iterator[Ping]:
        """Yield the selected pings of an open recording."""
        from oculus_driver.recording.chunk import messages_of  # noqa: PLC0415 - slow to import

        pings = self._decoded(messages_of(recording))
        if self.ping_id is not None:
            pings = (ping for ping in pings if ping.ping_id == self.ping_id)
        return islice(islice(pings, self.first, None, self.step), self.limit)

    def _decoded(self, messages: Iterable[Message]) -> Iterator[Ping]:
        for message in messages:
            if message.message_id != MessageId.PING_RESULT:
                continue
            ping = decode_ping(message)
            if isinstance(ping, Ping):
                yield ping
            else:
                self.rejects[ping.reason] += 1
