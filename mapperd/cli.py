"""The command `mapperd`: settings and a recording or a sonar in, a folder of results out."""

import os
import sys
import time
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, TextIO

import msgspec
import numpy as np

from mapperd.arguments import Arguments, parse_arguments
from mapperd.config import Config
from mapperd.config_file import load_config
from mapperd.doctor_command import doctor
from mapperd.errors import ConfigError, ExportError, LiveError, ReplayError
from mapperd.export.atomic import make_folder
from mapperd.export.folder import write_results
from mapperd.export.picture import MISSING, can_draw
from mapperd.export.summary import recording_facts, summary_of
from mapperd.frames import Pose
from mapperd.live_command import map_live
from mapperd.mapping import SonarMap
from mapperd.pairing import FixedPose, OdometryPoses
from mapperd.progress import ProgressBar
from mapperd.replay import Replay, Window, contents, first_range_m
from oculus_driver.errors import OculusError, RecordingError, SettingsError
from oculus_driver.recording import open_recording

__all__ = ["Exit", "main"]


class Exit(IntEnum):
    """Exit codes; those above 64 are of sysexits.h."""

    OK = 0
    USAGE = 2
    BAD_DATA = 65
    NO_INPUT = 66
    UNAVAILABLE = 69
    CANNOT_WRITE = 73
    BAD_CONFIG = 78
    INTERRUPTED = 130


_EXITS = {
    ConfigError: Exit.BAD_CONFIG,
    LiveError: Exit.UNAVAILABLE,
    SettingsError: Exit.BAD_CONFIG,
    RecordingError: Exit.BAD_DATA,
    ExportError: Exit.CANNOT_WRITE,
    OculusError: Exit.UNAVAILABLE,
}
"""The first kind that an error is."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; every failure that input can cause is one line and an exit code."""
    _open_closed_streams()
    words = sys.argv[1:] if argv is None else argv
    if words[:1] == ["doctor"]:
        return doctor(words[1:])
    arguments = parse_arguments(words)
    try:
        return (
            _live(arguments) if arguments.replay is None else _replay(arguments, arguments.replay)
        )
    except ReplayError as error:
        return _fail(Exit.USAGE, f"{arguments.replay}: {error}")
    except (ConfigError, LiveError, ExportError, OculusError) as error:
        return _fail(next(code for kind, code in _EXITS.items() if isinstance(error, kind)), error)
    except KeyboardInterrupt:
        return _fail(Exit.INTERRUPTED, f"interrupted; results in {arguments.out} may be missing")


def _live(arguments: Arguments) -> Exit:
    """Map until told to stop, write."""
    sonar_map = SonarMap(_config(arguments))
    make_folder(arguments.out)
    if not can_draw():
        _say(MISSING)
    summary = map_live(sonar_map, _poses(arguments, sonar_map), arguments.duration_s, _say)
    write_results(arguments.out, sonar_map, summary)
    return _verdict(arguments, summary)


def _replay(arguments: Arguments, path: Path) -> Exit:
    """Check everything that can be checked, map, write."""
    sonar_map = SonarMap(_config(arguments))
    if (problem := _unreadable(path)) is not None:
        return _fail(Exit.NO_INPUT, problem)
    _require_data(path, odometry=arguments.pose is None)
    if arguments.pose is not None:
        _require_reach(path, arguments.pose, sonar_map)
    make_folder(arguments.out)
    if not can_draw():
        _say(MISSING)
    try:
        summary = _mapped(arguments, path, sonar_map)
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
    try:
        if path.is_dir():
            return f"{path}: is a folder, not a recording"
        if not path.exists():
            return f"{path}: there is no such file"
        if not path.is_file():
            return f"{path}: is not a file"
    except OSError as error:  # such as a name that is too long
        return f"{path}: {error.strerror}"
    return None if os.access(path, os.R_OK) else f"{path}: may not be read"


def _require_data(path: Path, *, odometry: bool) -> None:
    """Refuse early what could only end in a map without a ping."""
    with open_recording(path) as recording:
        has_sonar, has_odometry = contents(recording)
        damage = f" ({recording.damage})" if recording.damage else ""
        if not has_sonar and not has_odometry:
            raise RecordingError(f"{path}: nothing can be read from it{damage}")
        if not has_sonar:
            raise RecordingError(f"{path}: no sonar data in it{damage}")
        if odometry and not has_odometry:
            raise ReplayError(
                f"no odometry in it{damage}, so nobody knows where the vehicle was; if it stood "
                "still, say where with --pose x,y,z,roll,pitch,yaw"
            )


def _require_reach(path: Path, pose: Pose, sonar_map: SonarMap) -> None:
    """Refuse early a pose whose map would not fit into map.bt."""
    sonar_m = (pose.map_T_base @ sonar_map.base_T_sonar)[:3, 3]
    with open_recording(path) as recording:
        range_m = first_range_m(recording)
    if np.abs(sonar_m).max() + range_m > sonar_map.octomap_reach_m:
        raise ReplayError(
            f"--pose and the range of {range_m:g} m leave the reach of map.bt, "
            f"+-{sonar_map.octomap_reach_m:g} m with voxels of {sonar_map.resolution_m:g} m; "
            "set a larger octree.voxel_resolution, or move the pose nearer to the origin"
        )


def _poses(arguments: Arguments, sonar_map: SonarMap) -> FixedPose | OdometryPoses:
    if arguments.pose is not None:
        return FixedPose(arguments.pose)
    return OdometryPoses(sonar_map.config)


def _mapped(arguments: Arguments, path: Path, sonar_map: SonarMap) -> dict[str, Any]:
    """Run the replay; returns its summary."""
    poses = _poses(arguments, sonar_map)
    window = Window(arguments.start_s, arguments.duration_s)
    replay = Replay(sonar_map, poses, window, time.perf_counter)
    began_s = time.perf_counter()
    with open_recording(path) as recording:
        bar = ProgressBar(sys.stderr, time.perf_counter)
        for _ in replay.run(recording):
            bar.show(recording.bytes_read / recording.size_bytes, replay.counters.pings_mapped)
        bar.close(replay.counters.pings_mapped)
        wall_s = time.perf_counter() - began_s
        return summary_of(recording_facts(recording), sonar_map, poses, replay.counters, wall_s)


def _verdict(arguments: Arguments, summary: dict[str, Any]) -> Exit:
    """Say how it went; a map without a single ping is a failure."""
    dropped = ", ".join(f"{why} {count}" for why, count in summary["pings_dropped"].items())
    damage = summary["recording"]["damage"] if "recording" in summary else None
    source = arguments.replay or "live"
    if summary["pings_mapped"] == 0:
        damaged = f" (damaged: {damage})" if damage else ""
        return _fail(Exit.BAD_DATA, f"{source}: {_why_empty(summary, dropped)}{damaged}")
    if damage:
        _say(f"{source}: damaged: {damage}")
    lost = f" (dropped: {dropped})" if dropped else ""
    problem = _written(
        sys.stdout,
        f"mapped {summary['pings_mapped']} of {summary['pings_total']} pings{lost} in "
        f"{summary['wall_s']:.1f} s: {summary['voxels_occupied']} occupied voxels in "
        f"{arguments.out}\n",
    )
    if problem is not None:
        return _fail(Exit.CANNOT_WRITE, f"standard output: cannot be written: {problem}")
    return Exit.OK


def _why_empty(summary: dict[str, Any], dropped: str) -> str:
    if summary["pings_total"]:
        return f"no ping could be mapped: {dropped}"
    if outside := summary["pings_outside"]:
        return f"no ping lies in the chosen part; {outside} were read outside of it"
    if "live" in summary:
        return f"no ping came from the sonar ({summary['live']['sonar']})"
    rejected, total = summary["bytes_rejected"], summary["bytes_total"]
    return f"no ping in it; {rejected} of {total} bytes of sonar data rejected"


def _open_closed_streams() -> None:
    """Give standard streams that are closed (`>&-`) a place to write to."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 while we run
            setattr(sys, name, nowhere)


def _written(stream: TextIO, text: str) -> str | None:
    """Write to a standard stream; returns why not, if not, and silences it from then on."""
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return error.strerror
    return None


def _say(message: object) -> None:
    _written(sys.stderr, f"mapperd: {message}\n")  # if not, nobody is there to be told


def _fail(code: Exit, message: object) -> Exit:
    _say(message)
    return code
