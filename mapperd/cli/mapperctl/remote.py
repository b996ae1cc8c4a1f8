"""The commands that ask a running daemon."""

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from mapperd.cli.mapperctl.arguments import pose_said
from mapperd.cli.mapperctl.connection import Connection, Target
from mapperd.cli.mapperctl.errors import CtlError, Exit, plain
from mapperd.cli.mapperctl.views import event_line, localization_lines, params_lines, status_lines

__all__ = ["run"]

PATIENCE_S = 30.0
PATIENCE_WITH_DISKS_S = 900.0
SLOW = ("save", "reset", "snapshot", "reload", "set_map")
HOME_AND_CLEAR = "\x1b[H\x1b[J"

Lines = Iterator[str]


def run(said: argparse.Namespace, target: Target) -> Lines:
    """Do a command; yields what there is to print, as it comes.

    Raises:
        CtlError: it is not done.
    """
    if said.command == "status" and not said.once and (said.json or sys.stdout.isatty()):
        yield from _watch(said, target)
        return
    if said.command == "localization" and said.watch:
        yield from _watch(said, target)
        return
    slow = said.command in SLOW
    if said.command == "reset" and not said.yes:
        _ask_first(target)
    with Connection(target, PATIENCE_WITH_DISKS_S if slow else PATIENCE_S) as daemon:
        if said.command == "events":
            yield from _events(said, daemon)
            return
        result = daemon.ask(said.command, **_arguments(said))
        yield from [json.dumps(result)] if said.json else _PEOPLE[said.command](said, result)


def _arguments(said: argparse.Namespace) -> dict[str, Any]:
    if said.command in ("params", "get"):
        return {"names": said.names}
    if said.command == "set":
        return {"changes": dict(said.changes)}
    if said.command == "initial_pose":
        return {"pose": pose_said(said)}
    if said.command == "set_map":
        return {"name": said.name, "pose": pose_said(said)}
    if said.command == "localization":
        return {"particles": said.particles}
    return {"name": said.name} if said.command == "save" else {}


def _status(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from status_lines(result, None)


def _params(said: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from params_lines(result, origin=said.origin)


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
        yield plain(f"system of coordinates: {result['crs']}")


def _reset(_: argparse.Namespace, __: dict[str, Any]) -> Lines:
    yield "the map is empty"


def _reloaded(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    for name, value in result.get("changed", {}).items():
        yield plain(f"{name} is now {json.dumps(value)}")
    for name in result.get("waiting", ()):
        yield plain(f"{name}: waits for a restart")
    refused = [f"{name}: {why}" for name, why in result.get("refused", {}).items()]
    if refused:
        raise CtlError(f"settings stay as they are: {'; '.join(refused)}", Exit.REFUSED)
    if not result.get("changed") and not result.get("waiting"):
        yield "nothing is new"


def _snapshot(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield plain(f"{result.get('bytes')} bytes in {result.get('seconds', 0.0):.2f} s")


def _localization(_: argparse.Namespace, result: dict[str, Any]) -> Lines:
    yield from localization_lines(result)


def _begun(said: argparse.Namespace, _: dict[str, Any]) -> Lines:
    yield _BEGUN[said.command]


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


def _events(said: argparse.Namespace, daemon: Connection) -> Lines:
    for told in daemon.follow(said.since) if said.follow else _kept(said.since, daemon):
        if told["missed"]:
            yield (
                json.dumps({"missed": told["missed"]})
                if said.json
                else f"({told['missed']} events are not kept any more)"
            )
        for event in told["events"]:
            clock = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(event["t_s"]))
            yield json.dumps(event) if said.json else event_line(event, clock)


def _kept(since: int, daemon: Connection) -> Iterator[dict[str, Any]]:
    more = True
    while more:
        told = daemon.ask("events", since=since)
        yield told
        more = told["more"]
        since = told["events"][-1]["number"] if told["events"] else since


def _watch(said: argparse.Namespace, target: Target) -> Lines:
    """Look again and again; a daemon that is restarted is found again."""
    before: dict[str, Any] | None = None
    while True:
        try:
            with Connection(target, PATIENCE_S) as daemon:
                while True:
                    status = daemon.ask(said.command, **_arguments(said))
                    yield json.dumps(status) if said.json else _screen(said, status, before)
                    before = status
                    time.sleep(said.every)
        except CtlError as error:
            if said.json or before is None or error.code != Exit.UNAVAILABLE:
                raise
            yield f"{HOME_AND_CLEAR}{error}; looking for it"
        time.sleep(said.every)


def _screen(said: argparse.Namespace, status: dict[str, Any], before: dict[str, Any] | None) -> str:
    columns, rows = shutil.get_terminal_size()
    of_status = said.command == "status"
    told = status_lines(status, before) if of_status else localization_lines(status)
    lines = [line[:columns] for line in told]
    return HOME_AND_CLEAR + "\n".join(lines[: max(1, rows - 1)])


def _ask_first(target: Target) -> None:
    if not sys.stdin.isatty():
        raise CtlError("reset empties the map: say --yes", Exit.USAGE)
    sys.stderr.write(f"Empty the map of {target}? [y/N] ")
    sys.stderr.flush()
    if os.read(sys.stdin.fileno(), 100).strip().lower() not in (b"y", b"yes"):
        raise CtlError("not done", Exit.REFUSED)
