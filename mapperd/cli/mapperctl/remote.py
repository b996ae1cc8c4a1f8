"""The commands that ask a running daemon."""

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mapperd.cli.mapperctl.arguments import pose_from_args
from mapperd.cli.mapperctl.connection import (
    ControlConnection,
    CtlError,
    DaemonTarget,
    plain,
)
from mapperd.cli.mapperctl.sonar import run_sonar
from mapperd.cli.mapperctl.views import event_line, localization_lines, params_lines, status_lines
from mapperd.config.layers import load_files, settings_files, text_with, user_folder
from mapperd.config.loader import config_from_text
from mapperd.errors import ExportError
from mapperd.io import atomic_file
from oculus_driver.command_line import ExitCode

__all__ = ["run"]

USAGE = ExitCode.USAGE

ANSWER_TIMEOUT_S = 30.0
DISK_TIMEOUT_S = 900.0
SLOW = ("save", "reset", "snapshot", "reload", "set_map")
PERIOD_S = 1.0
"""Period of `--watch`."""

HOME_AND_CLEAR = "\x1b[H\x1b[J"

Lines = Iterator[str]


def run(args: argparse.Namespace, target: DaemonTarget) -> Lines:
    """Run a command; yield what is to be printed, as it comes.

    Raises:
        CtlError: it is not done.
    """
    watch = args.command == "status" and (args.watch or args.every is not None or args.json)
    if watch and not args.once:
        yield from _watch(args, target)
        return
    if args.command == "localization" and args.watch:
        yield from _watch(args, target)
        return
    if args.command == "sonar":
        yield from run_sonar(args, target)
        return
    slow = args.command in SLOW
    if args.command == "reset" and not args.yes:
        _ask_first(target)
    with ControlConnection(target, DISK_TIMEOUT_S if slow else ANSWER_TIMEOUT_S) as daemon:
        if args.command == "events":
            yield from _events(args, daemon)
            return
        files = _files_for(args, daemon) if getattr(args, "persist", None) is not None else {}
        result = daemon.ask(args.command, **_arguments(args))
        yield from [json.dumps(result)] if args.json else _PEOPLE[args.command](args, result)
        for path, text in _persisted(args, files).items():
            _write(path.resolve(), text)
            if not args.json:
                yield plain(f"{path}: written")


def _files_for(args: argparse.Namespace, daemon: ControlConnection) -> dict[str, Path]:
    """Return the settings file of each changed setting: the one that names it, or the topmost."""
    if args.address:
        raise CtlError("--persist writes files of the daemon's computer: run it there", USAGE)
    names = [name for name, _ in args.changes]
    if args.persist != Path():
        return dict.fromkeys(names, args.persist)
    facts = daemon.ask("params", names=[])
    origins = dict.fromkeys(fact["origin"] for fact in facts.values())
    known = [Path(origin) for origin in origins if origin.endswith((".yaml", ".yml"))]
    usual = settings_files([], os.environ)
    known.sort(key=lambda path: usual.index(path) if path in usual else len(usual))
    own = user_folder(os.environ)
    if not known and own is not None:
        known = [own / "mapperd.yaml"]
    if not known or not all(path.is_absolute() for path in known):
        names_found = ", ".join(map(str, known)) or "none"
        raise CtlError(f"which settings file is not clear ({names_found}): --persist FILE", USAGE)
    return {name: _naming(name, known) for name in names}


def _naming(name: str, files: list[Path]) -> Path:
    """Return the topmost file that names a setting, or the topmost."""
    naming = [path for path in files if path.exists() and name in load_files([path]).origins]
    return (naming or files)[-1]


def _write(path: Path, text: str) -> None:
    try:
        mode = path.stat().st_mode if path.exists() else None
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            file.write(text.encode())
        if mode is not None:
            path.chmod(mode)
    except (OSError, ExportError) as error:
        text = f"the daemon uses the new values; {error}"
        raise CtlError(text, ExitCode.CANNOT_WRITE) from error


def _persisted(args: argparse.Namespace, files: Mapping[str, Path]) -> dict[Path, str]:
    """Return the new texts of settings files."""
    texts: dict[Path, str] = {}
    for name, path in files.items():
        if path not in texts:
            texts[path] = path.read_text("utf-8") if path.exists() else ""
        texts[path] = text_with(texts[path], name, dict(args.changes)[name])
    for path, text in texts.items():
        config_from_text(text, str(path))
    return texts


def _arguments(args: argparse.Namespace) -> dict[str, Any]:
    if args.command in ("params", "get"):
        return {"names": args.names}
    if args.command == "set":
        return {"changes": dict(args.changes)}
    if args.command == "initial_pose":
        return {"pose": pose_from_args(args)}
    if args.command == "set_map":
        return {"name": args.name, "pose": pose_from_args(args)}
    if args.command == "localization":
        return {"particles": args.particles}
    return {"name": args.name} if args.command == "save" else {}


def _status(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from status_lines(result, None, colours=_has_colours())


def _params(args: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from params_lines(result, origin=args.origin)


def _get(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    for name, value in result.items():
        yield f"{name} = {json.dumps(value)}"


def _changed(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    for name, (before, after) in result["changed"].items():
        yield f"{name}: {json.dumps(before)} is now {json.dumps(after)}"
    if not result["changed"]:
        yield "nothing changed"


def _saved(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield plain(f"{result.get('path')}: {result.get('bytes')} bytes")
    if "crs" in result:
        yield plain(f"coordinate reference system: {result['crs']}")


def _reset(_: argparse.Namespace, __: dict[str, Any]) -> Lines:
    yield "the map is empty"


def _reloaded(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    for name, value in result.get("changed", {}).items():
        yield plain(f"{name} is now {json.dumps(value)}")
    for name in result.get("waiting", ()):
        yield plain(f"{name}: waits for a restart")
    refused = [f"{name}: {why}" for name, why in result.get("refused", {}).items()]
    if refused:
        raise CtlError(f"settings stay as they are: {'; '.join(refused)}", ExitCode.FAULT)
    if not result.get("changed") and not result.get("waiting"):
        yield "nothing is new"


def _snapshot(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield plain(f"{result.get('bytes')} bytes in {result.get('seconds', 0.0):.2f} s")


def _localization(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from localization_lines(result)


def _begun(args: argparse.Namespace, _: dict[str, Any]) -> Lines:
    yield _BEGUN[args.command]


_BEGUN: Mapping[str, str] = MappingProxyType(
    {
        "initial_pose": "localization begins at this pose",
        "global_localization": "localization begins anywhere on the map",
        "request_nomotion_update": "the next scan is an update",
    }
)


def _map_set(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield plain(f"localizing on {result.get('path')}")


_PEOPLE: Mapping[str, Callable[[argparse.Namespace, dict[str, Any]], Lines]] = MappingProxyType(
    {
        "status": _status,
        "params": _params,
        "get": _get,
        "set": _changed,
        "save": _saved,
        "reset": _reset,
        "reload": _reloaded,
        "snapshot": _snapshot,
        "localization": _localization,
        "initial_pose": _begun,
        "global_localization": _begun,
        "request_nomotion_update": _begun,
        "set_map": _map_set,
    }
)


def _events(args: argparse.Namespace, daemon: ControlConnection) -> Lines:
    for batch in daemon.follow(args.since) if args.follow else _kept(args.since, daemon):
        if batch["missed"]:
            yield (
                json.dumps({"missed": batch["missed"]})
                if args.json
                else f"({batch['missed']} events were discarded)"
            )
        for event in batch["events"]:
            clock = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(event["t_s"]))
            yield json.dumps(event) if args.json else event_line(event, clock)


def _kept(since: int, daemon: ControlConnection) -> Iterator[dict[str, Any]]:
    more = True
    while more:
        batch = daemon.ask("events", since=since)
        yield batch
        more = batch["more"]
        since = batch["events"][-1]["number"] if batch["events"] else since


def _has_colours() -> bool:
    return (
        sys.stdout.isatty()
        and "NO_COLOR" not in os.environ
        and os.environ.get("TERM", "dumb") != "dumb"
    )


def _watch(args: argparse.Namespace, target: DaemonTarget) -> Lines:
    """Look again and again; a daemon that is restarted is found again."""
    before: dict[str, Any] | None = None
    while True:
        try:
            with ControlConnection(target, ANSWER_TIMEOUT_S) as daemon:
                while True:
                    status = daemon.ask(args.command, **_arguments(args))
                    yield json.dumps(status) if args.json else _screen(args, status, before)
                    before = status
                    daemon.wait(args.every or PERIOD_S)
        except CtlError as error:
            if args.json or before is None or error.code != ExitCode.UNAVAILABLE:
                raise
            yield f"{HOME_AND_CLEAR}{error}; looking for it"
        time.sleep(args.every or PERIOD_S)


def _screen(args: argparse.Namespace, status: dict[str, Any], before: dict[str, Any] | None) -> str:
    columns, rows = shutil.get_terminal_size()
    if args.command == "status":
        lines = [*status_lines(status, before, colours=_has_colours())]
    else:
        lines = [line[:columns] for line in localization_lines(status)]
    return HOME_AND_CLEAR + "\n".join(lines[: max(1, rows - 1)])


def _ask_first(target: DaemonTarget) -> None:
    if not sys.stdin.isatty():
        raise CtlError("reset empties the map; confirm with --yes", ExitCode.USAGE)
    sys.stderr.write(f"Empty the map of {target}? [y/N] ")
    sys.stderr.flush()
    if os.read(sys.stdin.fileno(), 100).strip().lower() not in (b"y", b"yes"):
        raise CtlError("not done", ExitCode.FAULT)
