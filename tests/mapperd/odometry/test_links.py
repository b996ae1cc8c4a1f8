"""Real sockets and a real pseudo terminal: bytes in, losses reported, links reopened."""

import asyncio
import os
import pty
import socket
import time
import tty
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from mapperd.config.odometry import parse_address
from mapperd.odometry.links import OdometryLink, OdometryLinkStatus
from tests.support.waiting import until

pytestmark = pytest.mark.net

States = list[tuple[str, str]]
Heard = list[tuple[bytes, bool]]


def run(text: str, work: Callable[[OdometryLink, Heard, States], Awaitable[None]]) -> States:
    """Run a link while `work` plays its other end; returns every state it went through."""
    heard: Heard = []
    reported: States = []

    def take(data: bytes, arrival_ns: int, *, gap: bool) -> None:
        assert abs(time.monotonic_ns() - arrival_ns) < 10**10
        heard.append((data, gap))

    def report(name: str, status: OdometryLinkStatus) -> None:
        assert name == "dvl"
        reported.append((str(status.phase), status.reason))

    async def both() -> None:
        link = OdometryLink("dvl", parse_address(text), take, time.monotonic_ns, report)
        task = asyncio.create_task(link.run())
        try:
            await work(link, heard, reported)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(both())
    return reported


def test_datagrams_come_one_by_one() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    async def work(link: OdometryLink, heard: Heard, _: States) -> None:
        await until(lambda: link.status.opened == 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in (b"a", b"", b"bcd"):
                sender.sendto(data, ("127.0.0.1", port))
        await until(lambda: len(heard) == 3)
        assert [data for data, _ in heard] == [b"a", b"", b"bcd"]

    reported = run(f"udp://127.0.0.1:{port}", work)
    assert [phase for phase, _ in reported] == ["opening", "waiting", "receiving", "closed"]


def test_a_sender_that_goes_away_and_comes_back_is_heard_again() -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    listener.setblocking(False)  # noqa: FBT003 the socket's own argument

    async def work(link: OdometryLink, heard: Heard, reported: States) -> None:
        loop = asyncio.get_running_loop()
        client, _ = await loop.sock_accept(listener)
        await loop.sock_sendall(client, b"one")
        await until(lambda: len(heard) == 1)
        client.close()
        client, _ = await loop.sock_accept(listener)
        await loop.sock_sendall(client, b"two")
        await until(lambda: len(heard) == 2)
        client.close()
        assert heard == [(b"one", False), (b"two", True)]  # the parser learns of the cut
        assert link.status.losses == 1
        assert ("backing off", f"TCP 127.0.0.1:{port}: closed by the other side") in reported

    run(f"tcp://127.0.0.1:{port}", work)
    listener.close()


def test_nobody_there_is_reported_and_tried_again() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    async def work(link: OdometryLink, _: Heard, reported: States) -> None:
        await until(lambda: link.status.losses == 2)
        assert "Connect call failed" in reported[1][1] or "refused" in reported[1][1]

    run(f"tcp://127.0.0.1:{port}", work)


def test_a_serial_line_is_unplugged_and_plugged_in_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pseudo terminal under a name of udev's; the second one is another device."""
    monkeypatch.setattr("mapperd.config.odometry.UDEV_FOLDERS", (tmp_path,))
    plug = tmp_path / "usb-DVL"

    def plug_in() -> tuple[int, int]:
        ours, theirs = pty.openpty()
        tty.setraw(theirs)
        plug.symlink_to(os.ttyname(theirs))
        return ours, theirs

    async def work(link: OdometryLink, heard: Heard, reported: States) -> None:
        ours, theirs = plug_in()
        await until(lambda: link.status.opened == 1)
        os.close(theirs)
        os.write(ours, b"$GPHDT,1.0,T*00\r\n\x00\xff")
        await until(lambda: b"".join(data for data, _ in heard).endswith(b"\xff"))
        plug.unlink()
        os.close(ours)
        await until(lambda: link.status.losses >= 2)  # lost, then looked for in vain
        assert any("is it plugged in" in reason for _, reason in reported)
        heard.clear()
        ours, theirs = plug_in()
        await until(lambda: link.status.opened == 2)
        os.close(theirs)
        os.write(ours, b"back")
        await until(lambda: bool(heard))
        assert heard[0][1] is True
        os.close(ours)

    run("serial:usb-DVL?baud=115200", work)
