"""`mapperd calibrate`: mounting, time offset and scale of the ranges from a recording."""

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from mapperd import __version__
from mapperd.cli.replay import unreadable
from mapperd.config.layers import load_settings
from mapperd.config.tree import Config
from mapperd.errors import ConfigError, ExportError, MapperdError, missing_extra
from mapperd.io import atomic_file, make_folder
from mapperd.session.recordings import RecordedSession, files_in, sessions_of
from oculus_driver.command_line import CommandParser, ExitCode
from oculus_driver.errors import RecordingError

if TYPE_CHECKING:
    from mapperd.calibration.dive import CalibrationDive
    from mapperd.calibration.estimate import Calibration, ParameterEstimate

__all__ = ["calibrate_command", "calibrate_parser"]

_EXITS = (
    (ConfigError, ExitCode.BAD_CONFIG),
    (ExportError, ExitCode.CANNOT_WRITE),
    (OSError, ExitCode.CANNOT_WRITE),
    (Exception, ExitCode.BAD_DATA),
)
UNITS = {"time_offset": "s", "range_scale": "", "x": "m", "y": "m", "z": "m"}
DIGITS = {"time_offset": 4, "range_scale": 4}
HALF_M, PIXELS = 0.3, 41
"""Half the side of the pictures, and their pixels along a side."""


def calibrate_command(argv: Sequence[str]) -> int:
    """Run `mapperd calibrate`; every failure is one line and an exit code."""
    args = calibrate_parser().parse_args(argv)
    if (problem := unreadable([args.recording])) is not None:
        return _fail(ExitCode.NO_INPUT, problem)
    missing = next((name for name in ("scipy", "matplotlib") if find_spec(name) is None), None)
    if missing is not None:
        return _fail(ExitCode.BAD_CONFIG, missing_extra(missing, "calibrate"))
    try:
        return _calibrate(args)
    except (MapperdError, RecordingError, OSError) as error:
        return _fail(next(code for kind, code in _EXITS if isinstance(error, kind)), error)
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED


def _calibrate(args: argparse.Namespace) -> int:
    from mapperd.calibration.estimate import calibrate, yaml_lines  # noqa: PLC0415

    config = load_settings([] if args.config is None else [args.config], os.environ).config
    make_folder(args.out)
    sessions = sessions_of(files_in([args.recording], begun=True))
    if not sessions:
        raise RecordingError(f"{args.recording}: no recording with anything in it")
    dive = _read(sessions, config)
    found = calibrate(dive, config, _progress)
    lines = yaml_lines(found, config, dive.sound_mps)
    facts = [_facts(one) for one in found.parameters]
    for name, text in (("calibration.yaml", lines), ("calibration.json", json.dumps(facts))):
        with atomic_file(args.out / name) as file:
            file.write(text.encode())
    _draw(found, args.out / "calibration.png")
    print("\n".join(map(_row, found.parameters)))  # noqa: T201 a command speaks
    print(f"\n{lines}\nwritten to {args.out}/calibration.yaml")  # noqa: T201
    return 0


def _read(sessions: Sequence[RecordedSession], config: Config) -> "CalibrationDive":
    """Read the largest session that can be used, and name those that are left out.

    Raises:
        ReplayError, RecordingError: no session can be used; the reason is that of the largest.
    """
    from mapperd.calibration.dive import read_dive  # noqa: PLC0415 needs an extra

    problem: Exception | None = None
    for session in sorted(sessions, key=lambda one: one.size_bytes, reverse=True):
        try:
            dive = read_dive(session, config)
        except (MapperdError, RecordingError) as error:
            problem = problem or error
            continue
        left = [str(one.paths[0]) for one in sessions if one is not session]
        if left:
            text = f"uses {session.paths[0]}, the longest usable session; without {', '.join(left)}"
            print(f"mapperd: {text}", file=sys.stderr)  # noqa: T201 a command speaks
        return dive
    assert problem is not None  # noqa: S101 there are sessions
    raise problem


def _facts(one: "ParameterEstimate") -> dict[str, object]:
    """Return a parameter for JSON, which has no infinity."""
    deviation = one.deviation if math.isfinite(one.deviation) else None
    return asdict(one) | {"deviation": deviation, "observable": one.observable}


def _row(one: "ParameterEstimate") -> str:
    digits, unit = DIGITS.get(one.name, 2), UNITS.get(one.name, "deg")
    deviation = f"± {one.deviation:.{digits}f} {unit}".rstrip()
    if not one.observable:
        known = f" ({deviation})" if math.isfinite(one.deviation) else ""
        return f"{one.name:<12} not observable{known}, left: {one.reason}"
    left = "" if one.significant else ", left: not more than its deviation"
    return f"{one.name:<12} {one.change:+.{digits}f} {deviation}{left}"


def _draw(found: "Calibration", path: Path) -> None:
    """Draw the mean of what pings show where pings of other passes saw a spot, before and after."""
    import numpy as np  # noqa: PLC0415 as the next ones
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    offsets_m = np.linspace(-HALF_M, HALF_M, PIXELS)
    before, after = (found.compared.stack(v, offsets_m) for v in (found.start, found.values))
    limit = max(float(before.max()), float(after.max()), 1e-9)
    figure = Figure(figsize=(11, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle("Where one pass saw a bright spot, the other passes show on average:")
    edge_cm = 100 * HALF_M
    for place, (name, stack) in enumerate((("Before", before), ("After", after))):
        axes = figure.add_subplot(1, 2, place + 1)
        extent = (-edge_cm, edge_cm, -edge_cm, edge_cm)
        image = axes.imshow(
            stack, origin="lower", extent=extent, cmap="inferno", vmin=0, vmax=limit
        )
        axes.axhline(0, color="white", linewidth=0.5)
        axes.axvline(0, color="white", linewidth=0.5)
        share = float(stack[PIXELS // 2, PIXELS // 2]) / limit
        axes.set_title(f"{name}: {max(share, 0.0):.0%} of the brightness in place")
        axes.set_xlabel("to starboard, cm")
        axes.set_ylabel("farther, cm")
    figure.colorbar(image, label="brightness, over its surroundings")
    with atomic_file(path) as file:
        figure.savefig(file, format="png", dpi=100)


def calibrate_parser() -> CommandParser:
    """Return the parser of `mapperd calibrate`."""
    parser = CommandParser(
        "mapperd calibrate",
        description="Estimate mounting angles, time offset and scale of the ranges from a "
        "recording over floor and structure (docs/guides/calibrate.md).",
        epilog="exit codes: 0 done; 65 unusable recording; 66 cannot open it; 73 cannot write; "
        "78 invalid settings or a missing extra; 130 interrupted",
    )
    add = parser.add_argument
    add(
        "recording",
        metavar="RECORDING",
        type=Path,
        help="recording, or a folder: its longest usable session",
    )
    add("--config", metavar="YAML", type=Path, help="settings file with the measured mounting")
    add(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("mapperd-calibration"),
        help="folder for calibration.yaml, .json and .png (default: mapperd-calibration)",
    )
    add("--version", action="version", version=f"mapperd {__version__}")
    return parser


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(f"mapperd: {text}", file=sys.stderr)  # noqa: T201


def _fail(code: ExitCode, message: object) -> int:
    print(f"mapperd: {message}", file=sys.stderr)  # noqa: T201
    return code
