"""Peers send to their readers on real links."""

import asyncio
import os
import socket

import pytest

from mapperd.config.odometry import FormatName, FormatSettings
from mapperd.odometry.decoder import Decoder
from mapperd.odometry.formats import make_decoder
from mapperd.odometry.records import Odometry
from tests.support.peers.autopilot import Autopilot
from tests.support.peers.dvl import Dvl
from tests.support.peers.misbehaviour import Misbehaviour
from tests.support.peers.nmea_talker import NmeaTalker
from tests.support.peers.serial_pty import SerialPty
from tests.support.peers.wire import send_udp, tcp_server

pytestmark = pytest.mark.net

LIMIT_S = 20.0


def link(name: FormatName, *, datagrams: bool = False) -> Decoder:
    return make_decoder(FormatSettings(format=name), datagrams=datagrams)


def records(decoder: Decoder, *pieces: bytes) -> int:
    found = [result for piece in pieces for result in decoder.feed(piece, None)]
    return sum(isinstance(result, Odometry) for result in found)


async def heard(port: int) -> bytes:
    async with asyncio.timeout(LIMIT_S):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        data = b""
        try:
            while piece := await reader.read(1000):
                data += piece
        except ConnectionResetError:
            pass
        writer.close()
        return data


def test_dvl_is_heard_over_tcp_by_each_client() -> None:
    async def work() -> None:
        messages = [Dvl().velocity() for _ in range(5)]
        async with tcp_server(lambda: Misbehaviour(max_bytes=99).pieces(messages)) as port:
            for _ in range(2):
                assert records(link("water_linked_json"), await heard(port)) == 5

    asyncio.run(work())


def test_dvl_may_reset_the_connection() -> None:
    async def work() -> None:
        async with tcp_server(lambda: [Dvl().velocity()[:50]], reset=True) as port:
            assert records(link("water_linked_json"), await heard(port)) == 0

    asyncio.run(work())


def test_autopilot_is_heard_over_udp() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(LIMIT_S)
        autopilot = Autopilot()
        messages = [autopilot.local_position((n, 0, 0)) + autopilot.heartbeat() for n in range(5)]
        send_udp(messages, receiver.getsockname()[1])
        pieces = [receiver.recv(2000) for _ in messages]
    assert records(link("mavlink", datagrams=True), *pieces) == 5


@pytest.mark.parametrize(
    ("name", "message"),
    [("nmea", NmeaTalker().hdt()), ("water_linked_serial", Dvl().velocity_sentence())],
)
def test_serial_line_changes_no_byte(name: FormatName, message: bytes) -> None:
    with SerialPty() as line:
        ours = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        line.send(message)
        data = b""
        while len(data) < len(message):
            data += os.read(ours, 1000)
        os.write(ours, b"\x11\x13\r\n")
        assert line.heard() == b"\x11\x13\r\n"
        os.close(ours)
    assert data == message
    assert records(link(name), data) == 1


def test_unplugged_line_ends_and_can_be_plugged_in_again() -> None:
    with SerialPty() as line:
        ours = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        line.unplug()
        with pytest.raises(OSError, match="Input/output error"):
            raise_at_end(ours)
        os.close(ours)
        line.plug()
        line.send(b"x")
        again = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        assert os.read(again, 1) == b"x"
        os.close(again)


def raise_at_end(descriptor: int) -> None:
    """An unplugged line reads as an error on some kernels, as an end on others."""
    if not os.read(descriptor, 1):
        raise OSError("Input/output error")


def test_stall_holds_messages_back_and_loses_none() -> None:
    bad = Misbehaviour(stall_from=1, stall_for=2)
    assert list(bad.pieces([b"a", b"b", b"c", b"d", b"e"])) == [b"a", b"", b"", b"bcd", b"e"]
