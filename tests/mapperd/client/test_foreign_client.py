"""A client written from docs/reference/map-stream.md alone holds the same map."""

import asyncio
import hashlib
import hmac
import socket
import struct
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
import zstandard

from mapperd.client import MapMirror
from mapperd.wire.blocks import path_message
from mapperd.wire.messages import Interest
from tests.support.stream_server import MAP_INFO, TOKEN, Served, Server, a_block

pytestmark = pytest.mark.net

Key = tuple[int, int, int]


class Foreign:
    """From here on there is only the document."""

    def __init__(self, host: str, port: int, token: bytes) -> None:
        self.cells: dict[Key, bytes] = {}
        self.path: list[tuple[float, ...]] = []
        self.held: dict[str, Any] | None = None
        self._token = token
        self._address = (host, port)

    def follow_until_complete(self, *, detail: str = "log_odds") -> None:
        """One connection, until all of the interest has arrived."""
        with socket.create_connection(self._address, 5) as self._socket:
            self._read_bytes = 0
            for message in self._messages():
                kind = message["t"]
                if kind == "greeting":
                    self._send_hello(message, detail)
                elif kind == "welcome":
                    self._welcomed(message)
                elif kind == "reset":
                    self.cells.clear()
                elif kind == "blocks":
                    self._take(message.get("body", b""), detail)
                    if message.get("complete") is not None:
                        assert self.held is not None
                        self.held["revision"] = message["complete"]
                        return
                elif kind == "path":
                    self._go(message)
                elif kind == "bye":
                    raise ConnectionError(message["reason"])
                if kind not in ("greeting", "welcome"):
                    self._send({"t": "ack", "bytes": self._read_bytes})

    def _messages(self) -> Iterator[dict[str, Any]]:
        while True:
            (size,) = struct.unpack(">I", self._exactly(4))
            yield msgpack.unpackb(self._exactly(size))

    def _exactly(self, size: int) -> bytes:
        read = b""
        while len(read) < size:
            piece = self._socket.recv(size - len(read))
            if not piece:
                raise ConnectionError("hung up")
            read += piece
        self._read_bytes += size
        return read

    def _send(self, message: dict[str, Any]) -> None:
        body = msgpack.packb(message)
        self._socket.sendall(struct.pack(">I", len(body)) + body)

    def _send_hello(self, greeting: dict[str, Any], detail: str) -> None:
        assert greeting["mapperd"] == "map stream"
        assert 1 in greeting.get("versions", [1])
        proof = ""
        if challenge := greeting.get("challenge", ""):
            output = b"mapperd-control-1 " + challenge.encode()
            proof = hmac.new(self._token, output, hashlib.sha256).hexdigest()
        hello = {"t": "hello", "version": 1, "proof": proof, "wants": ["map", "path"]}
        hello["interest"] = {"detail": detail}
        self._send(hello | {"resume": self.held})

    def _welcomed(self, welcome: dict[str, Any]) -> None:
        if not welcome["resumed"]:
            self.cells.clear()
        self.held = {"map": welcome["map"]["id"], "session": welcome["session"], "revision": 0}

    def _take(self, body: bytes, detail: str) -> None:
        if not body:
            return
        data = zstandard.ZstdDecompressor().decompress(body, max_output_size=2_131_972)
        (number,) = struct.unpack_from("<I", data)
        x, y, z = (struct.unpack_from(f"<{number}i", data, 4 + 4 * number * i) for i in range(3))
        kinds = data[4 + 16 * number : 4 + 17 * number]
        at = 4 + 17 * number
        uniform = iter(data[at : at + kinds.count(1)])
        at += kinds.count(1)
        for key, kind in zip(zip(x, y, z, strict=True), kinds, strict=True):
            if kind == 0:
                self.cells.pop(key, None)
            elif kind == 1:
                self.cells[key] = bytes([next(uniform)]) * 512
            else:
                self.cells[key] = data[at : at + 512]
                at += 512
        assert at + (512 * sum(kind > 0 for kind in kinds) if detail == "counts" else 0) == len(
            data
        )

    def _go(self, message: dict[str, Any]) -> None:
        points = struct.iter_unpack("<3f", message["points"])
        rest = struct.iter_unpack("<3f", message.get("rest") or bytes(len(message["points"])))
        del self.path[message["first"] :]
        for point, left in zip(points, rest, strict=True):
            self.path.append(tuple(a + b for a, b in zip(point, left, strict=True)))


def cells_of(served: Served) -> dict[Key, bytes]:
    """What the daemon knows, by our own mirror."""
    mirror = MapMirror(MAP_INFO, Interest())
    mirror.put(served.since(0), 0)
    blocks = mirror.blocks()
    keys = map(tuple, blocks.keys.tolist())
    return {key: cells.tobytes() for key, cells in zip(keys, blocks.cells, strict=True)}


def test_a_client_made_from_the_document_holds_the_same_cells() -> None:
    async def follow() -> None:
        served = Served(token=TOKEN)
        for number in range(20):
            served.put((number, -number, 7), a_block(number))
        served.put((1, 2, 3), a_block(0) * 0 - 6)
        async with Server(served) as server:
            foreign = Foreign("127.0.0.1", server.port, TOKEN)
            await asyncio.to_thread(foreign.follow_until_complete)
            assert foreign.cells == cells_of(served)
            served.put((3, -3, 7), a_block(99))
            served.forget((4, -4, 7))
            sent = served.sent
            await asyncio.to_thread(foreign.follow_until_complete)
            assert foreign.cells == cells_of(served)
            assert served.sent - sent < sent / 5  # and not all of it again
            served.start_again("map-2")
            await asyncio.to_thread(foreign.follow_until_complete)
            assert foreign.cells == cells_of(served)

    asyncio.run(follow())


def test_it_holds_the_same_path_near_and_far() -> None:
    async def follow() -> None:
        served = Served(token=TOKEN)
        near_m = np.array([[1.0, 2.0, -3.0], [1.5, 2.5, -3.5], [9.0, 9.0, 9.0]])
        far_m = np.array([[500_000.123, 4_649_776.25, -3.1], [500_000.3, 4_649_776.4, -3.2]])
        async with Server(served) as server:
            foreign = Foreign("127.0.0.1", server.port, TOKEN)
            served.path = path_message(0, near_m)
            await asyncio.to_thread(foreign.follow_until_complete)
            served.path = path_message(2, far_m)
            await asyncio.to_thread(foreign.follow_until_complete)
        reported = np.array(foreign.path)
        np.testing.assert_allclose(reported, np.vstack([near_m[:2], far_m]), rtol=0, atol=1e-6)

    asyncio.run(follow())
