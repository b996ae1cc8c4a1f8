"""Coverage-guided fuzzing of both ends of the map stream, with atheris.

Usage: python -m tests.fuzz.fuzz_map_stream CORPUS [-max_total_time=600] [options of libFuzzer]

`make fuzz` runs it. An input that breaks a check ends the run and is left in the working folder.
Minimise it (-minimize_crash=1), and add it to `map_stream.cases` together with the repair.
"""

import contextlib

import numpy as np
import zstandard

from mapperd.client.protocol import ClientProtocol, StreamOptions
from mapperd.client.state import ClientState
from mapperd.wire.blocks import CELLS, MAX_KEY, decode_blocks
from mapperd.wire.framing import StreamError, framed, server_inbox
from mapperd.wire.messages import (
    MAX_BLOCKS,
    MAX_FROM_CLIENT,
    WANTS,
    GreetingMessage,
    Interest,
    MapInfo,
    WelcomeMessage,
)
from tests.fuzz.cases import fuzz

MAP_INFO = MapInfo("map", 0.1, 0.25, 0.6, -1.4)
WELCOME = WelcomeMessage(
    version=1,
    server="",
    vehicle="",
    session="",
    map=MAP_INFO,
    revision=0,
    resumed=False,
    ticket="t",
)
BEGIN = framed(GreetingMessage()) + framed(WELCOME)
BLOCK_LIMIT = 4096
INTERESTS = (Interest(detail="classes"), Interest(level=3), Interest(detail="counts"))


def _client_survives(data: bytes, choice: int) -> None:
    """Check that a client accepts bytes or disconnects, and that its state stays sound."""
    interest = INTERESTS[choice % 3]
    client_state = ClientState(interest, lambda _: None, BLOCK_LIMIT)
    protocol = ClientProtocol(StreamOptions(WANTS, interest), client_state, None, lambda _: None)
    if choice & 1:
        protocol.receive(BEGIN)
    half = len(data) // 2
    with contextlib.suppress(StreamError):
        protocol.receive(data[:half])
        protocol.receive(data[half:])
    _is_sound(client_state)


def _is_sound(client_state: ClientState) -> None:
    """Check that the state is a path and a map of bounded size."""
    if client_state.path.shape[1:] != (3,) or not np.isfinite(client_state.path).all():
        raise AssertionError("the path is not finite")
    mirror = client_state.mirror
    if mirror is not None:
        mirror.digest()
        mirror.cells("known")
        if len(mirror) > BLOCK_LIMIT + MAX_BLOCKS:
            raise AssertionError(f"{len(mirror)} blocks")


def _server_survives(data: bytes) -> None:
    """Check that bytes of a client are messages or refused, and that few of them are buffered."""
    inbox = server_inbox()
    with contextlib.suppress(StreamError):
        inbox.feed(data)
        if len(inbox) > MAX_FROM_CLIENT + 4:
            raise AssertionError(f"{len(inbox)} bytes are buffered")


def _blocks_are_blocks(data: bytes, *, counts: bool) -> None:
    """Check that any columns are blocks of the right shape or refused."""
    try:
        blocks = decode_blocks(zstandard.compress(data), counts=counts)
    except StreamError:
        return
    number = len(blocks)
    if number > MAX_BLOCKS or blocks.cells.shape != (number, CELLS):
        raise AssertionError(f"{number} blocks")
    if number and abs(blocks.keys.astype("i8")).max() >= MAX_KEY:
        raise AssertionError("a key out of range")


def one_input(data: bytes) -> None:
    """Check one input; raise an error where a check fails."""
    if not data:
        return
    choice, body = data[0], data[1:]
    _client_survives(body, choice)
    _client_survives(len(body).to_bytes(4, "big") + body, choice)
    _server_survives(body)
    _server_survives(len(body).to_bytes(4, "big") + body)
    _blocks_are_blocks(body, counts=bool(choice & 1))


if __name__ == "__main__":
    fuzz("map_stream", one_input)
