"""The command `mapperd`: settings and a recording in, a folder of results out."""

import os
import sys
import time
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any

import msgspec

from mapperd.arguments import Arguments, parse_arguments
from mapperd.config import Config
from mapperd.config_file import load_config
from mapperd.errors import ConfigError, ExportError, ReplayError
from mapperd.export.atomic import make_folder
from mapperd.export.folder import write_results
from mapperd.export.picture import MISSING, can_draw
from mapperd.export.summary import summary_of
from mapperd.mapping import SonarMap
from mapperd.pairing import FixedPose, OdometryPoses
from mapperd.progress import ProgressBar
from mapperd.replay import Replay, Window, encodings
from oculus_driver.errors import RecordingError
from oculus_driver.recording import OCULUS, ODOMETRY_NATIVE, open_recording

__all__ = ["Exit", "main"]


class Exit(IntEnum):
    """Exit codes; those above 64 are of sysexits.h."""

    OK = 0
    USAGE = 2
    BAD_DATA = 65
    NO_INPUT = 66
    CANNOT_WRITE = 73
    BAD_CONFIG = 78
    INTERRUPTED = 130


_EXITS = {
    ConfigError: Exit.BAD_CONFIG,
    RecordingError: Exit.BAD_DATA,
    ExportError: Exit.CANNOT_WRITE,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; every failure that input can cause is one line and an exit code."""
    arguments = parse_arguments(sys.argv[1:] if argv is None else argv)
    try:
        return _replay(arguments)
    except ReplayError as error:
        return _fail(Exit.USAGE, f"{arguments.replay}: {error}")
    except (ConfigError, RecordingError, ExportError) as error:
        return _fail(_EXITS[type(error)], error)
    except OSError as error:
        return _fail(Exit.NO_INPUT, f"{arguments.replay}: {error.strerror}")
    except KeyboardInterrupt:
        return _fail(Exit.INTERRUPTED, f"interrupted; results in {arguments.out} may be missing")


def _replay(arguments: Arguments) -> Exit:
    """Check everything that can be checked, map, write."""
    sonar_map = SonarMap(_config(arguments))
    if (problem := _unreadable(arguments.replay)) is not None:
        return _fail(Exit.NO_INPUT, problem)
    _require_data(arguments.replay, odometry=arguments.pose is None)
    make_folder(arguments.out)
    if not can_draw():
        _say(MISSING)
    try:
        summary = _mapped(arguments, sonar_map)
    except KeyboardInterrupt:
        return _fail(Exit.INTERRUPTED, "interrupted; nothing was written")
    write_results(arguments.out, sonar_map, summary)
    return _verdict(arguments, summary)


def _config(arguments: Arguments) -> Config:
    config = Config() if arguments.config is None else load_config(arguments.config)
    if arguments.integrator is None:
        return config
    try:
        mapping = msgspec.structs.replace(config.mapping, integrator=arguments.integrator)
    except ValueError as error:  # the section's own rules
        raise ConfigError(f"--integrator: {error}", "$.mapping.integrator") from error
    return msgspec.structs.replace(config, mapping=mapping)


def _unreadable(path: Path) -> str | None:
    """Why a path cannot be a recording at all, before its content is looked at."""
    if path.is_dir():
        return f"{path}: is a folder, not a recording"
    if not path.exists():
        return f"{path}: there is no such file"
    if not path.is_file():
        return f"{path}: is not a file"
    return None if os.access(path, os.R_OK) else f"{path}: may not be read"


def _require_data(path: Path, *, odometry: bool) -> None:
    """Refuse early what could only end in a map without a ping."""
    needed = ODOMETRY_NATIVE if odometry else OCULUS
    with open_recording(path) as recording:
        found = encodings(recording, until=needed)
        damage = f" ({recording.damage})" if recording.damage else ""
        if not found:
            raise RecordingError(f"{path}: nothing can be read from it{damage}")
        if OCULUS not in found and needed not in found:
            raise RecordingError(f"{path}: no sonar data in it{damage}")
        if needed not in found:
            raise ReplayError(
                f"no odometry in it{damage}, so nobody knows where the vehicle was; if it stood "
                "still, say where with --pose x,y,z,roll,pitch,yaw"
            )


def _mapped(arguments: Arguments, sonar_map: SonarMap) -> dict[str, Any]:
    """Run the replay; returns its summary."""
    settings = sonar_map.config.time_sync
    poses = OdometryPoses(settings) if arguments.pose is None else FixedPose(arguments.pose)
    window = Window(arguments.start_s, arguments.duration_s)
    replay = Replay(sonar_map, poses, window, time.perf_counter)
    began_s = time.perf_counter()
    with open_recording(arguments.replay) as recording:
        bar = ProgressBar(sys.stderr, time.perf_counter)
        for _ in replay.run(recording):
            bar.show(recording.bytes_read / recording.size_bytes, replay.counters.pings_mapped)
        bar.close(replay.counters.pings_mapped)
        wall_s = time.perf_counter() - began_s
        return summary_of(recording, sonar_map, poses, replay.counters, wall_s)


def _verdict(arguments: Arguments, summary: dict[str, Any]) -> Exit:
    """Say how it went; a map without a single ping is a failure."""
    dropped = ", ".join(f"{why} {count}" for why, count in summary["pings_dropped"].items())
    damage = summary["recording"]["damage"]
    if summary["pings_mapped"] == 0:
        rejected, total = summary["bytes_rejected"], summary["bytes_total"]
        reason = (
            f"no ping could be mapped: {dropped}"
            if summary["pings_total"]
            else f"no ping in it; {rejected} of {total} bytes of sonar data rejected"
        )
        damaged = f" (damaged: {damage})" if damage else ""
        return _fail(Exit.BAD_DATA, f"{arguments.replay}: {reason}{damaged}")
    if damage:
        _say(f"{arguments.replay}: damaged: {damage}")
    lost = f" (dropped: {dropped})" if dropped else ""
    sys.stdout.write(
        f"mapped {summary['pings_mapped']} of {summary['pings_total']} pings{lost} in "
        f"{summary['wall_s']:.1f} s: {summary['voxels_occupied']} occupied voxels in "
        f"{arguments.out}\n"
    )
    return Exit.OK


def _say(message: object) -> None:
    sys.stderr.write(f"mapperd: {message}\n")


def _fail(code: Exit, message: object) -> Exit:
    _say(message)
    return code
