"""What stands ready before a reader follows a page of docs/: a sonar, a daemon, files.

`own_network` gives the addresses that the pages name to the reader's network alone.
"""

from __future__ import annotations

import shlex
import shutil
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

from tests.support.peers.mosquitto import mosquitto_path
from tests.support.shell_blocks import Block, Reader

if TYPE_CHECKING:
    from collections.abc import Callable

MAPPED = "mapperctl status --once | grep -Eq '^pings +[1-9][0-9]* mapped'"
"""Succeeds once the daemon has mapped a ping."""

NATIVE = "--vehicle native --position 0,0,-0.3 --orientation 0,90,0 --range 8"


def _run(reader: Reader, code: str) -> None:
    done = reader.run(code)
    assert done.returncode == 0, f"{code}\n{done.stdout}{done.stderr}"


def _start(reader: Reader, stack: ExitStack, program: str, ready: str) -> None:
    stack.enter_context(reader.background(Block(program, ready=ready)))


def _add_settings(reader: Reader, text: str) -> None:
    """Add to vehicle.yaml."""
    with (reader.folder / "vehicle.yaml").open("a") as file:
        file.write(text)


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


def bluerov2(reader: Reader, stack: ExitStack) -> None:
    """A simulated sonar on a BlueROV2 with a Water Linked DVL at its default address."""
    pytest.importorskip("pymavlink", reason="the extra `mavlink` is not installed")
    _addresses(reader, "192.168.2.95/32")
    reader.write_scene()
    links = ("mavlink-ardusub@udp:127.0.0.1:52210", "waterlinked@tcp:192.168.2.95:16171")
    serve = " --odometry ".join(["sonar-sim serve scene.yaml", *links])
    _start(reader, stack, serve, "oculus discover --first")


def maps(reader: Reader, stack: ExitStack) -> None:
    """`daemon`, and two maps of it: before.map and after.bt."""
    daemon(reader, stack)
    _run(reader, "mapperctl export before.map && mapperctl export after.bt")


def page(reader: Reader, stack: ExitStack) -> None:
    """`daemon`, and dive.map."""
    pytest.importorskip("viser", reason="the extra `topside` is not installed")
    daemon(reader, stack)
    _run(reader, "mapperctl export dive.map")


def users_file(reader: Reader, _: ExitStack) -> None:
    """The user's settings of a BlueROV2, as the README writes them."""
    _run(reader, "mapperd init --yes")


def foxglove(reader: Reader, stack: ExitStack) -> None:
    """`daemon`."""
    pytest.importorskip("foxglove", reason="the extra `foxglove` is not installed")
    daemon(reader, stack)


def recordings(reader: Reader, _: ExitStack) -> None:
    """Recordings of a daemon, which has ended."""
    with ExitStack() as session:
        daemon(reader, session)


def known_map(reader: Reader, stack: ExitStack) -> None:
    """A daemon that localizes on a known map; another is harbour.yaml in its folder."""
    vehicle(reader, stack)
    with ExitStack() as session:
        _start(reader, session, "mapperd --config vehicle.yaml", MAPPED)
        _run(reader, "mapperctl save harbour.pgm && mapperctl export known.map")
    _add_settings(
        reader,
        "localization: {mode: track, map_path: known.map, boundaries_only: true}\n"
        "amcl: {set_initial_pose: true}\n",
    )
    localizes = "mapperctl localization | grep -Eq '^(localized|ambiguous|lost)'"
    _start(reader, stack, "mapperd --config vehicle.yaml", localizes)


def telemetry(reader: Reader, stack: ExitStack) -> None:
    """A broker at 192.168.2.1, and a daemon that publishes there and accepts commands."""
    pytest.importorskip("aiomqtt", reason="the extra `mqtt` is not installed")
    broker = mosquitto_path()
    if broker is None or shutil.which("mosquitto_pub") is None:
        pytest.skip("Mosquitto is not installed: apt install mosquitto mosquitto-clients")
    _addresses(reader, "192.168.2.1/32")
    (reader.folder / "broker.conf").write_text(
        "listener 1883 192.168.2.1\npersistence false\nuser root\nallow_anonymous true\n"
    )
    probe = "mosquitto_pub -h 192.168.2.1 -t probe -m up"
    _start(reader, stack, f"{broker} -c broker.conf", probe)
    vehicle(reader, stack)
    _add_settings(reader, "mqtt: {host: 192.168.2.1, vehicle: rov-1, commands: true}\n")
    _start(reader, stack, "mapperd --config vehicle.yaml", MAPPED)


def own_disk(reader: Reader, stack: ExitStack) -> None:
    """`sonar`, and a disk at /mnt."""
    sonar(reader, stack)
    _run(reader, "mount -t tmpfs -o size=64g disk /mnt")


def cluster(reader: Reader, stack: ExitStack) -> None:
    """A Dask cluster with its scheduler at the host `head`, and storage with a bucket."""
    for name in ("distributed", "s3fs", "moto"):
        pytest.importorskip(name, reason=f"{name} is not installed: make install")
    _addresses(reader, "192.168.2.10/32")
    _run(
        reader, "(cat /etc/hosts; echo 192.168.2.10 head) > hosts && mount --bind hosts /etc/hosts"
    )
    reader.environment |= {
        "AWS_ENDPOINT_URL": "http://192.168.2.10:5000",
        "AWS_ACCESS_KEY_ID": "reader",
        "AWS_SECRET_ACCESS_KEY": "reader",
        "AWS_DEFAULT_REGION": "eu-north-1",
    }
    python = shlex.quote(sys.executable)
    storage = f"{python} -m moto.server --host 192.168.2.10 --port 5000"
    _start(reader, stack, storage, "curl -sfX PUT http://192.168.2.10:5000/bucket")
    scheduler = f"{python} -m distributed.cli.dask_scheduler --host head --no-dashboard"
    _start(reader, stack, scheduler, "true")
    worker = f"{python} -m distributed.cli.dask_worker tcp://head:8786 --no-dashboard"
    _start(reader, stack, worker, "grep -q Registered $OUTPUT")


STAGES: dict[str, Callable[[Reader, ExitStack], None]] = {
    "choosing": daemon,
    "driver": own_disk,
    "export": maps,
    "first-dive": users_file,
    "foxglove": foxglove,
    "hardware": sonar,
    "live": bluerov2,
    "localization": known_map,
    "odometry": vehicle,
    "ros-bags": recordings,
    "survey": cluster,
    "telemetry": telemetry,
    "troubleshooting": daemon,
    "view": page,
}
"""By the name of the page."""
