"""`mapperctl`: looks at a mapper and steers it."""

import argparse
import json
import os
import ssl
import stat
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from mapperd.cli.mapperctl.arguments import parser
from mapperd.cli.mapperctl.connection import CtlError, DaemonTarget
from mapperd.cli.mapperctl.remote import run
from mapperd.cli.mapperctl.views import params_lines
from mapperd.config.layers import Layered, load_settings, user_folder
from mapperd.config.live import facts_of
from mapperd.config.paths import socket_places
from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.server.listeners import address_of
from mapperd.wire.auth import read_token
from oculus_driver.command_line import ExitCode

__all__ = ["main"]

OFFLINE = ("bag", "convert", "diff")
"""Commands that need no daemon."""

BRIDGES = ("changes", "foxglove", "mavlink", "ros2")
"""Commands that serve other programs until they are stopped."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; what is wrong is one line and an exit code."""
    args = parser().parse_args(argv)
    try:
        for line in _lines(args):
            print(line, flush=True)  # noqa: T201 a command speaks
    except CtlError as error:
        return _fail(error, error.code)
    except ConfigError as error:
        return _fail(error, ExitCode.BAD_CONFIG)
    except BrokenPipeError:  # `mapperctl params | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt:
        endless = args.command in ("status", "view", *BRIDGES) or any(
            getattr(args, name, False) for name in ("follow", "watch")
        )
        return ExitCode.OK if endless else ExitCode.INTERRUPTED
    return ExitCode.OK


def _lines(args: argparse.Namespace) -> Iterator[str]:
    if args.command == "view":
        from mapperd.cli.mapperctl import view  # noqa: PLC0415 only it needs numpy

        if args.file is None:
            yield from view.run_view(args, *_stream(args))
        else:
            yield from view.run_file_view(args, _settings(args).config)
        return
    if args.command in BRIDGES:
        from mapperd.cli.mapperctl.bridges import run_bridge  # noqa: PLC0415 needs numpy

        run_bridge(args, _settings(args).config, *_stream(args))
        return
    if args.command == "record":
        from mapperd.cli.mapperctl.record import run_record  # noqa: PLC0415 needs numpy

        yield from run_record(args, _settings(args).config, *_stream(args))
        return
    if args.command == "export":
        from mapperd.cli.mapperctl.export import run_export  # noqa: PLC0415 needs numpy

        yield from run_export(args, _settings(args).config, *_stream(args))
        return
    if args.command in OFFLINE:
        from mapperd.cli.mapperctl import offline  # noqa: PLC0415 the core, which others do not need

        yield from offline.run(args, _settings(args).config)
        return
    remote = args.command != "params" or args.running or args.socket or args.address
    if remote:
        yield from run(args, _target(args))
        return
    layered = load_settings(args.config, os.environ)
    facts = facts_of(layered.config, layered.origin_of, args.names)
    if args.json:
        yield json.dumps(facts, indent=2)
    else:
        yield from params_lines(facts, origin=args.origin)


def _stream(args: argparse.Namespace) -> tuple[str, bytes | None, ssl.SSLContext | None]:
    """Where the map stream is, as `mapperd.client` takes it, with its token and TLS."""
    if args.address and args.socket:
        raise CtlError("--socket or --address, not both", ExitCode.USAGE)
    if args.address:
        from mapperd.client.connect import daemon_address  # noqa: PLC0415 needs numpy

        try:
            daemon_address(args.address)
            path = _token_path(args, _settings(args).config)
            token = None if path is None else read_token(path)
        except (ConfigError, ValueError) as error:
            raise CtlError(str(error), ExitCode.USAGE) from error
        return args.address, token, _tls(args.tls_ca)
    if args.socket:
        return str(args.socket.absolute()), None, None
    return "", None, None


def _target(args: argparse.Namespace) -> DaemonTarget:
    """Address of the daemon: from the arguments, the settings, or the usual places."""
    if args.address and args.socket:
        raise CtlError("--socket or --address, not both", ExitCode.USAGE)
    if args.socket:
        return DaemonTarget(args.socket)
    config = _settings(args).config
    if args.address:
        return _over_tcp(args, config)
    places = socket_places(config, os.environ)
    for path in places:
        if _is_socket(path):
            return DaemonTarget(path)
    looked = ", ".join(map(str, places))
    raise CtlError(
        f"no daemon is running: no socket at {looked}; start mapperd, or give --address",
        ExitCode.UNAVAILABLE,
    )


def _settings(args: argparse.Namespace) -> Layered:
    """Return the settings of the files, or the defaults if this user cannot read them."""
    try:
        return load_settings(args.config, os.environ)
    except ConfigError:
        if args.config:
            raise
        return Layered(Config())


def _over_tcp(args: argparse.Namespace, config: Config) -> DaemonTarget:
    try:
        host, port = address_of(args.address)
        path = _token_path(args, config)
        token = b"" if path is None else read_token(path)
    except ConfigError as error:
        raise CtlError(str(error), ExitCode.USAGE) from error
    return DaemonTarget(None, str(host), port, token, _tls(args.tls_ca))


def _token_path(args: argparse.Namespace, config: Config) -> Path | None:
    """Return the file of --token-file, of the settings, or the copy in the user's folder."""
    given = args.token_file or config.server.token_file
    if given:
        return Path(given)
    folder = user_folder(os.environ)
    copied = None if folder is None else folder / "token"
    return copied if copied is not None and copied.exists() else None


def _tls(authorities: Path | None) -> ssl.SSLContext | None:
    if authorities is None:
        return None
    try:
        return ssl.create_default_context(cafile=str(authorities))
    except OSError as error:
        raise CtlError(f"{authorities}: no certificates: {error}", ExitCode.USAGE) from error


def _is_socket(path: Path) -> bool:
    try:
        return stat.S_ISSOCK(path.stat().st_mode)
    except OSError:
        return False


def _fail(error: Exception, code: ExitCode) -> ExitCode:
    print(f"mapperctl: {error}", file=sys.stderr)  # noqa: T201
    return code
