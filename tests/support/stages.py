"""What stands ready before a reader follows a page of docs/: a sonar, a daemon, files.

`own_network` gives the addresses that the pages name to the reader's network alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.shell_blocks import Block, Reader

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import ExitStack

MAPPED = "mapperctl status --once | grep -Eq '^pings +[1-9][0-9]* mapped'"
"""Succeeds once the daemon has mapped a ping."""

NATIVE = "--vehicle native --position 0,0,-0.3 --orientation 0,90,0 --range 8"


def _run(reader: Reader, code: str) -> None:
    done = reader.run(code)
    assert done.returncode == 0, f"{code}\n{done.stdout}{done.stderr}"


def _start(reader: Reader, stack: ExitStack, program: str, ready: str) -> None:
    stack.enter_context(reader.background(Block(program, ready=ready)))


def _addresses(reader: Reader, *addresses: str) -> None:
    """Give the reader's network these addresses."""
    if not reader.network:
        pytest.skip("no network of its own: nothing can have the addresses of the page")
    for address in addresses:
        _run(reader, f"ip address add {address} dev lo")


def sonar(reader: Reader, stack: ExitStack) -> None:
    """A sonar at 192.168.2.3, and a network card."""
    _addresses(reader, "192.168.2.3/32")
    _run(reader, "ip link add eth0 type veth && ip link set eth0 up")
    reader.write_scene()
    serve = "sonar-sim serve scene.yaml --listen 192.168.2.3 --status-to 127.0.0.1"
    _start(reader, stack, serve, "oculus discover --first")


def vehicle(reader: Reader, stack: ExitStack) -> None:
    """A simulated sonar and vehicle, and their settings: vehicle.yaml and token."""
    reader.write_scene()
    _start(reader, stack, "sonar-sim serve scene.yaml", "oculus discover --first")
    _run(reader, f"mapperd init vehicle.yaml --yes --sonar 127.0.0.1 {NATIVE}")


def daemon(reader: Reader, stack: ExitStack) -> None:
    """`vehicle` and a daemon that maps, also at 192.168.2.2:7471."""
    _addresses(reader, "192.168.2.1/32", "192.168.2.2/32")
    vehicle(reader, stack)
    _start(reader, stack, "mapperd --config vehicle.yaml", MAPPED)


STAGES: dict[str, Callable[[Reader, ExitStack], None]] = {
    "choosing": daemon,
    "hardware": sonar,
    "odometry": vehicle,
}
"""By the name of the page."""
