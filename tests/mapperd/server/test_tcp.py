"""What the system reports about real sockets."""

import asyncio
import socket
import ssl
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from mapperd.server.connection import ClientConnection
from mapperd.server.pacer import CALM, TCP_CC_INFO, TcpState, tcp_state, tune
from mapperd.wire.auth import Limits
from tests.mapperd.server.watched import Bed, Watcher, bed_of
from tests.support.control_server import TOKEN
from tests.support.waiting import run

pytestmark = pytest.mark.net

Pair = tuple[socket.socket, socket.socket]


def connected(listener: socket.socket) -> Pair:
    here = socket.create_connection(listener.getsockname())
    there, _ = listener.accept()
    return here, there


@pytest.fixture
def pair() -> Iterator[Pair]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        here, there = connected(listener)
        with here, there:
            yield here, there


def test_a_connection_has_a_round_trip_and_nothing_that_waits(pair: Pair) -> None:
    here, there = pair
    here.sendall(bytes(1000))
    assert len(there.recv(1000, socket.MSG_WAITALL)) == 1000
    state = tcp_state(here)
    assert state.round_trip_s is not None
    assert 0 < state.round_trip_s < 1
    assert state.unsent == 0


def test_what_a_reader_does_not_take_waits(pair: Pair) -> None:
    here, there = pair
    here.settimeout(0)
    given = 0
    unsent = []
    for _ in range(3):
        given += here.send(bytes(20_000))
        unsent.append(tcp_state(here).unsent)
    assert 0 < unsent[0] < unsent[1] < unsent[2] < given
    assert unsent[2] - unsent[1] == 20_000
    there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    there.recv(given, socket.MSG_WAITALL)
    assert tcp_state(here).unsent == 0


def test_a_local_socket_reports_neither() -> None:
    here, there = socket.socketpair()
    with here, there:
        tune(here)
        here.sendall(bytes(1000))
        assert tcp_state(here) == TcpState()


def test_a_socket_that_is_closed_reports_nothing(pair: Pair) -> None:
    pair[0].close()
    assert tcp_state(pair[0]) == TcpState()


def test_a_tuned_one_waits_for_nothing_and_is_calm_where_the_system_can_be(pair: Pair) -> None:
    here, _ = pair
    here.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, b"reno")
    tune(here)
    assert here.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    name = here.getsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, 16).rstrip(b"\0")
    allowed = Path("/proc/sys/net/ipv4/tcp_available_congestion_control").read_bytes().split()
    assert name == CALM or CALM not in allowed


class Answering:
    """A socket of a system that reports what a test wants."""

    def __init__(self, name: bytes, family: int = socket.AF_INET) -> None:
        self.name, self.family = name, family

    def getsockopt(self, level: int, name: int, size: int, /) -> bytes:
        assert level == socket.IPPROTO_TCP
        if name == socket.TCP_CONGESTION:
            return self.name.ljust(size, b"\0")
        if name == TCP_CC_INFO:
            # <linux/inet_diag.h>: bbr_bw_lo, bbr_bw_hi, bbr_min_rtt and more; others differ.
            return struct.pack("<III", 31_000, 2, 99_000).ljust(size, b"\7")[:size]
        assert name == socket.TCP_INFO
        info = bytearray(256)
        struct.pack_into("<I", info, 16, 1_448)  # tcpi_snd_mss
        struct.pack_into("<IIII", info, 24, 20, 9, 2, 1)  # tcpi_unacked, _sacked, _lost, _retrans
        struct.pack_into("<II", info, 40, 99, 98)  # tcpi_fackets, tcpi_last_data_sent
        struct.pack_into("<I", info, 68, 250_000)  # tcpi_rtt of <linux/tcp.h>
        struct.pack_into("<I", info, 72, 125_000)  # tcpi_rttvar
        struct.pack_into("<I", info, 144, 777)  # tcpi_notsent_bytes
        struct.pack_into("<I", info, 148, 125_500)  # tcpi_min_rtt
        struct.pack_into("<Q", info, 160, 12_345)  # tcpi_delivery_rate
        return bytes(info[:size])


def test_a_system_is_understood() -> None:
    packets = 20 - 9 - 2 + 1
    known = (777, 0.1255, 0.25, packets * 1_448)
    cubic = Answering(b"cubic")
    assert tcp_state(cubic) == TcpState(*known, 12_345.0)
    rate = 31_000 + 2 * 2.0**32
    assert tcp_state(Answering(CALM)) == TcpState(777, 0.099, *known[2:], rate)


def test_packets_under_way_have_not_arrived(pair: Pair) -> None:
    here, there = pair
    here.settimeout(0)
    here.send(bytes(100_000))  # its reader takes some thousand
    state = tcp_state(here)
    assert state.in_network < 100_000
    there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    there.recv(100_000, socket.MSG_WAITALL)
    assert tcp_state(here).in_network == 0


def test_a_local_socket_is_not_asked() -> None:
    """Its options have the same numbers, and mean something else."""
    local = Answering(b"cubic", socket.AF_UNIX)
    assert tcp_state(local) == TcpState()


@pytest.mark.parametrize("name", [b"cubic", CALM])
def test_a_connection_reports_its_pacer_all_of_it(name: bytes) -> None:
    reported: list[tuple[object, ...]] = []
    pacer = SimpleNamespace(note_link=lambda *output, **more: reported.append((*output, more)))
    session: Any = SimpleNamespace(greeting=lambda _: b"", state="served", pacer=pacer)
    context: Any = SimpleNamespace(
        clock=lambda: 7.0, limits=Limits(), count=Counter().update, gone=lambda _: None
    )
    transport = Mock(spec=asyncio.Transport)
    transport.get_extra_info.return_value = Answering(name)
    transport.get_write_buffer_size.return_value = 1_000

    async def work() -> None:
        connection = ClientConnection(session, "a test", context)
        connection.connection_made(transport)
        connection.measure()
        connection.connection_lost(None)

    asyncio.run(work())
    rate = 31_000 + 2 * 2.0**32 if name == CALM else 12_345.0
    assert reported == [(1_777, 0.099 if name == CALM else 0.1255, 0.25, 14_480, rate, {})]


@pytest.mark.parametrize("kind", ["open", "tls", "unix"])
def test_the_pacer_knows_of_each_connection(
    kind: str, short: Path, tls: tuple[ssl.SSLContext, ssl.SSLContext]
) -> None:
    async def known(bed: Bed, watcher: Watcher) -> None:
        (client,) = bed.server._clients
        await watcher.until(lambda: watcher.complete == 5)
        pacer = client.session.pacer
        assert pacer.sent > 0
        if kind == "unix":
            assert pacer.round_trip_s is None
        else:
            while pacer.round_trip_s is None:  # noqa: ASYNC110 no event to await
                await asyncio.sleep(0.01)
            assert 0 < pacer.round_trip_s < 1
        client.session.pacer._unsent = 77
        client.measure()
        assert client.session.pacer._unsent == 0

    async def work() -> None:
        async with bed_of(short, tls[0]) as bed:
            for n in range(5):
                bed.source.put((n, 0, 0), n)
            watcher = await bed.watcher(kind, tls[1] if kind == "tls" else None)
            await watcher.hello(TOKEN if kind == "tls" else None)
            await known(bed, watcher)
            await watcher.leave()

    run(work())
