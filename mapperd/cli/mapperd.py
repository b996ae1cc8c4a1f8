"""The command `mapperd`: settings and a recording or a sonar in, a folder of results out."""

import asyncio
import contextlib
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import msgspec

from mapperd.cli.arguments import Arguments, parse_arguments
from mapperd.cli.calibrate import calibrate_command, calibrate_parser
from mapperd.cli.doctor import doctor, doctor_parser
from mapperd.cli.init import init, init_parser
from mapperd.cli.mapperctl.connection import CtlError
from mapperd.cli.replay import map_recordings, unreadable, unreadable_odometry
from mapperd.cli.surroundings import listen, odometry_lines, sonar_lines
from mapperd.config.layers import Layered, load_settings, settings_files
from mapperd.config.live import ConfigStore
from mapperd.config.tree import Config
from mapperd.daemon.map_folder import lost_bricks, write_results
from mapperd.daemon.run import LiveRun, map_live
from mapperd.daemon.supervisor import deferred_interrupt, graceful_stop
from mapperd.daemon.systemd import Notifier, goes_to_journal
from mapperd.errors import (
    CheckpointError,
    ConfigError,
    ExportError,
    ExportExtraError,
    LiveError,
    MapError,
    MapperdError,
    ReplayError,
    StoreError,
    missing_extra,
)
from mapperd.export.picture import can_draw
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.imaging.filter_chain import check_filters
from mapperd.io import make_folder
from mapperd.odometry.formats import check_levelling, check_libraries
from mapperd.pipeline.pose_lookup import FixedPose, OdometryPoses
from mapperd.pipeline.watchdog import process_progress
from mapperd.telemetry.broker import check_telemetry
from oculus_driver.command_line import ExitCode
from oculus_driver.errors import (
    OculusError,
    RecordingError,
    RecordingMissingError,
    RecordingUnwritableError,
    SettingsError,
)

if TYPE_CHECKING:
    from mapperd.cli.mapperctl.view import ReplayView
    from mapperd.mapping.sonar_map import SonarMap

__all__ = ["main"]


STDERR = 2

MAX_PLACES = 3
"""Number of damaged parts that a message names; the summary names more."""


REMEDIES = {
    "no_odometry": "no odometry arrived: check odometry.sources, or give the --pose of a vehicle "
    "that stands still",
    "no_position": "only attitude arrived: add a DVL or another position, or map from one spot "
    "with odometry.owners.position: fixed",
    **dict.fromkeys(
        ("before_odometry", "after_odometry", "odometry_gap"),
        "odometry and pings are apart in time: check the clocks of both recordings, or allow "
        "larger gaps with time_sync.max_gap_sec",
    ),
}
"""By reason why pings were dropped."""

_EXITS = {
    ExportExtraError: ExitCode.BAD_CONFIG,
    ConfigError: ExitCode.BAD_CONFIG,
    LiveError: ExitCode.UNAVAILABLE,
    SettingsError: ExitCode.BAD_CONFIG,
    RecordingMissingError: ExitCode.NO_INPUT,
    RecordingUnwritableError: ExitCode.CANNOT_WRITE,
    RecordingError: ExitCode.BAD_DATA,
    ExportError: ExitCode.CANNOT_WRITE,
    CheckpointError: ExitCode.BAD_DATA,
    MapError: ExitCode.CANNOT_WRITE,
    OculusError: ExitCode.UNAVAILABLE,
}
"""The first kind that an error is."""


_COMMANDS = {"calibrate": calibrate_command, "doctor": doctor, "init": init}
_PARSERS = (calibrate_parser, doctor_parser, init_parser)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; every failure that input can cause is one line and an exit code."""
    _open_closed_streams()
    words = sys.argv[1:] if argv is None else argv
    if words and (command := _COMMANDS.get(words[0])) is not None:
        return command(words[1:])
    arguments = parse_arguments(words, _PARSERS)
    try:
        return _replay(arguments) if arguments.replay else _live(arguments)
    except ReplayError as error:
        return _fail(ExitCode.USAGE, f"{_source(arguments)}: {error}")
    except StoreError as error:
        settings = error.reason in ("other_parameters", "newer_version", "not_a_store")
        return _fail(ExitCode.BAD_CONFIG if settings else ExitCode.CANNOT_WRITE, error)
    except (MapperdError, OculusError) as error:
        return _fail(_exit_of(error), error)
    except KeyboardInterrupt:
        return _fail(
            ExitCode.INTERRUPTED, f"interrupted; results in {arguments.out} may be missing"
        )


def _exit_of(error: Exception) -> ExitCode:
    if isinstance(error, CtlError):  # of the page
        return ExitCode(error.code)
    return next(code for kind, code in _EXITS.items() if isinstance(error, kind))


def _check_picture() -> None:
    """Report before the work that the results will have no picture."""
    with deferred_interrupt():
        drawn = can_draw()
    if not drawn:
        _print(f"map.png is not drawn: {missing_extra('matplotlib', 'topside')}")


HOW_TO_START = """\
to start:
  mapperd init                 asks for vehicle and sonar, and writes the settings
  mapperd --config FILE        maps live with your settings
  mapperd --replay FILE        maps a recording"""


def _without_settings() -> ExitCode:
    """List what is on the network and how to start; no sonar is asked for pings."""
    code = _fail(
        ExitCode.BAD_CONFIG,
        "no settings, so no sonar is started: run `mapperd init`, or pass --config",
    )
    heard = asyncio.run(listen())
    lines = [*sonar_lines(heard), *odometry_lines(heard), HOW_TO_START]
    _written(sys.stdout, "\n".join([*lines, ""]))
    return code


def _live(arguments: Arguments) -> ExitCode:
    """Map until stopped, then write the results."""
    if not settings_files(_given_files(arguments), os.environ):
        return _without_settings()
    store = ConfigStore(_settings(arguments))
    check_libraries(store.current.odometry, decoding=arguments.pose is None)
    if arguments.pose is None:
        check_levelling(store.current)
    check_telemetry(store.current, os.environ)
    make_folder(arguments.out)
    _check_picture()
    again = partial(_settings, arguments)
    notifier = Notifier(os.environ)
    with (
        contextlib.closing(notifier),
        contextlib.closing(TrajectoryWriter(arguments.out)) as trajectory,
        graceful_stop(),
    ):
        poses = partial(_poses, arguments)
        run = LiveRun(store, poses, arguments.duration_s, _print, again, notifier, trajectory)
        sonar_map, summary = map_live(run)
        with notifier.extended_timeout(process_progress), contextlib.closing(sonar_map):
            write_results(arguments.out, sonar_map, summary, trajectory)
    return _verdict(arguments, summary)


def _replay(arguments: Arguments) -> ExitCode:
    """Check, map, write."""
    problem = unreadable(arguments.replay)
    if problem is None and arguments.odometry is not None:
        problem = unreadable_odometry(arguments.odometry.paths)
    if problem is not None:
        return _fail(ExitCode.NO_INPUT, problem)

    def ready() -> None:
        make_folder(arguments.out)
        _check_picture()
        if arguments.odometry is not None:
            names = ", ".join(map(str, arguments.odometry.paths))
            _print(f"odometry of {names}; odometry in the recordings is ignored")

    def settings() -> Config:
        return _settings(arguments).config

    pages: list[ReplayView] = []

    def show(sonar_map: "SonarMap") -> "ReplayView | None":
        if arguments.view_port is None:
            return None
        with deferred_interrupt():
            from mapperd.cli.mapperctl.view import ReplayView  # noqa: PLC0415 the extra `topside`

            view = ReplayView(arguments.view_port, sonar_map, _source(arguments))
            pages.append(page := stack.enter_context(view))
        _print(page.line)
        return page

    with contextlib.ExitStack() as stack:
        trajectory = stack.enter_context(contextlib.closing(TrajectoryWriter(arguments.out)))
        try:
            sonar_map, summary = map_recordings(arguments, settings, ready, trajectory, show)
        except KeyboardInterrupt:
            return _fail(ExitCode.INTERRUPTED, f"interrupted; {_left_by_interrupt(arguments)}")
        stack.callback(sonar_map.close)
        write_results(arguments.out, sonar_map, summary, trajectory)
        code = _verdict(arguments, summary)
        for page in pages:
            page.wait(lambda: _print("the page stays until Ctrl-C"))
    return code


def _left_by_interrupt(arguments: Arguments) -> str:
    """Return what an interrupted replay has written."""
    if arguments.store is None or not arguments.store.exists():
        return "nothing was written"
    return f"{arguments.store} holds the last save; the same command maps the rest"


def _given_files(arguments: Arguments) -> list[Path]:
    return [] if arguments.config is None else [arguments.config]


def _settings(arguments: Arguments) -> Layered:
    """Of the files, and on top of them the command line."""
    layered = load_settings(_given_files(arguments), os.environ)
    if layered.notice:
        _print(layered.notice)
    ours = layered.config.localization
    if arguments.replay and ours.mode != "off" and not ours.map_path:
        _print("localization has no map: set localization.map_path to a saved map")
    check_filters(layered.config)
    if arguments.integrator is None:
        return layered
    try:
        mapping = msgspec.structs.replace(layered.config.mapping, integrator=arguments.integrator)
    except ValueError as error:  # the section's own rules
        raise ConfigError(f"--integrator: {error}", "$.mapping.integrator") from error
    config = msgspec.structs.replace(layered.config, mapping=mapping)
    origins = {**layered.origins, "mapping.integrator": "--integrator"}
    return replace(layered, config=config, origins=origins)


def _poses(arguments: Arguments, config: Config) -> FixedPose | OdometryPoses:
    if arguments.pose is not None:
        return FixedPose(arguments.pose)
    return OdometryPoses(config)


def _verdict(arguments: Arguments, summary: dict[str, Any]) -> ExitCode:
    """Print the result; a map without a ping or a part is a failure, unless a user stopped it."""
    dropped = ", ".join(f"{why} {count}" for why, count in summary["pings_dropped"].items())
    recording = summary.get("recording", {})
    damage = _damage(recording)
    source = _source(arguments)
    ended = "live" in summary and summary["live"]["told_to_stop"]
    nothing_asked = summary["config"]["localization"]["mapping"] == "off" and (
        "localization" in summary
    )
    missed = summary["pings_mapped"] == 0 and arguments.store is None
    if missed and not (ended or nothing_asked):
        damaged = f" (damaged: {damage})" if damage else ""
        return _fail(ExitCode.BAD_DATA, f"{source}: {_why_empty(summary, dropped)}{damaged}")
    if damage:
        _line(3 if recording["data_lost"] else 6, f"{source}: damaged: {damage}")
    lost = f" (dropped: {dropped})" if dropped else ""
    problem = _written(
        sys.stdout,
        f"mapped {summary['pings_mapped']} of {summary['pings_total']} pings{lost} in "
        f"{summary['wall_s']:.1f} s: {summary['voxels_occupied']} occupied voxels in "
        f"{arguments.out}\n",
    )
    if problem is not None:
        return _fail(ExitCode.CANNOT_WRITE, f"standard output: cannot be written: {problem}")
    code = ExitCode.BAD_DATA if recording.get("data_lost") else ExitCode.OK
    if (stored := summary.get("store", {})).get("data_lost"):
        named = list(stored["sessions_not_mapped"].items())
        listed = "; ".join(f"{session}: {why}" for session, why in named[:MAX_PLACES])
        more = "; …" if len(named) > MAX_PLACES else ""
        text = f"{stored['path']}: recorded data are not in the map: {listed}{more}"
        code = _fail(ExitCode.BAD_DATA, text)
    if bricks := lost_bricks(summary):
        path = summary["store"]["path"]
        code = _fail(
            ExitCode.BAD_DATA,
            f"{path}: {bricks} bricks are damaged, and their space is unknown: map.bt, map.ply and "
            "map.png are not written. `mapperctl convert --allow-damaged` writes the rest",
        )
    return _fail(ExitCode.CANNOT_WRITE, loss) if (loss := _loss(summary)) else code


def _loss(summary: dict[str, Any]) -> str:
    """Return what of a live session is not in the map file or not in the recordings."""
    losses = []
    if problem := summary.get("store", {}).get("loss"):
        losses.append(f"the map is not saved as a whole: {problem}")
    recorded = summary.get("live", {}).get("recording") or {}
    if dropped := recorded.get("bytes_dropped"):
        why = f" ({recorded['reason']})" if recorded["reason"] else ""
        losses.append(f"{dropped} bytes of the session are not recorded{why}")
    return "; ".join(losses)


def _damage(recording: dict[str, Any]) -> str:
    """Return the first damage of the recordings, and how many of their bytes are not mapped."""
    damage = recording.get("damage") or ""
    if not recording.get("damaged_parts"):
        return damage
    parts, size = recording["damaged_parts"], recording["damaged_bytes"]
    places = ", ".join(f"{part['file']} byte {part['offset']}" for part in parts[:MAX_PLACES])
    more = ", …" if len(parts) > MAX_PLACES else ""
    done = "were mapped all the same" if recording["damaged_used"] else "were not mapped"
    text = f"{size} bytes in {len(parts)} parts fail their checksum and {done} ({places}{more})"
    if decisions := recording.get("damaged_decisions"):
        text += f"; {decisions} recorded decisions are among them"
    hint = "" if recording["damaged_used"] else "; --allow-damaged maps them"
    return f"{damage}; {text}{hint}" if damage else f"{text}{hint}"


def _source(arguments: Arguments) -> str:
    """What the map is of, for messages."""
    return " ".join(map(str, arguments.replay[:1])) or "live"


def _why_empty(summary: dict[str, Any], dropped: str) -> str:
    if summary["pings_total"]:
        counts = summary["pings_dropped"]
        remedy = REMEDIES.get(max(counts, key=counts.__getitem__), "")
        return f"no ping could be mapped: {dropped}{remedy and '; '}{remedy}"
    if outside := summary["pings_outside"]:
        return f"no ping lies in the chosen part; {outside} were read outside of it"
    if "live" in summary:
        sonar = summary["live"]["sonar"]
        return f"no ping arrived from the sonar ({sonar}); `mapperd doctor` names what fails"
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


def _print(message: object) -> None:
    _line(6, message)


def _fail(code: ExitCode, message: object) -> ExitCode:
    _line(3, message)
    return code


def _line(priority: int, message: object) -> None:
    """A line of standard error; where that is the journal, with its priority."""
    mark = f"<{priority}>" if goes_to_journal(os.environ, STDERR) else "mapperd: "
    _written(sys.stderr, f"{mark}{message}\n")  # a closed stderr is ignored
