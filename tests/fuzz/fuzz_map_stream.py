"""Coverage-guided fuzzing of both ends of the map stream, with atheris.

Usage: python tests/fuzz/fuzz_map_stream.py CORPUS [-max_total_time=600] [options of libFuzzer]

Not collected by pytest: `make fuzz` runs it. An input that breaks a promise ends the run and is
left in the working folder; put it into the corpus once it is mended.
"""

import contextlib
import sys

import atheris
import msgspec
import numpy as np
import zstandard

from mapperd.client.protocol import Dialogue, Wishes
from mapperd.client.second_line import SecondDialogue
from mapperd.client.state import MAX_FORGOTTEN, Knowledge
from mapperd.wire.blocks import CELLS, MAX_KEY, decode_blocks
from mapperd.wire.framing import StreamError, framed, server_inbox
from mapperd.wire.messages import (
    MAX_BLOCKS,
    MAX_FROM_CLIENT,
    WANTS,
    Greeting,
    Interest,
    MapFacts,
    Welcome,
)

FACTS = MapFacts("map", 0.1, 0.25, 0.6, -1.4)
WELCOME = Welcome(
    version=1, server="", vehicle="", session="", map=FACTS, revision=0, resumed=False, ticket="t"
)
BEGIN = framed(Greeting()) + framed(WELCOME)
BEGIN_BESIDE = framed(Greeting()) + framed(msgspec.structs.replace(WELCOME, resumed=True))
MOST_BLOCKS = 4096
INTERESTS = (Interest(detail="classes"), Interest(level=3), Interest(detail="counts"))


def _client_survives(data: bytes, choice: int) -> None:
    """Whatever a server says is taken or ends the connection, and what is held stays sound."""
    interest = INTERESTS[choice % 3]
    knowledge = Knowledge(interest, lambda _: None, MOST_BLOCKS)
    dialogue = Dialogue(Wishes(WANTS, interest), knowledge, None, lambda _: None)
    if choice & 1:
        dialogue.receive(BEGIN)
    half = len(data) // 2
    with contextlib.suppress(StreamError):
        dialogue.receive(data[:half])
        dialogue.receive(data[half:])
    _is_sound(knowledge)


def _client_survives_beside(data: bytes, choice: int) -> None:
    """The same of what is said on a second line, or on both at once."""
    interest = INTERESTS[choice % 3]
    knowledge = Knowledge(interest, lambda _: None, MOST_BLOCKS)
    first = Dialogue(Wishes(WANTS, interest), knowledge, None, lambda _: None)
    first.receive(BEGIN)
    second = SecondDialogue("", knowledge, None)
    if choice & 1:
        second.receive(BEGIN_BESIDE)
    with contextlib.suppress(StreamError):
        second.receive(data)
        if choice & 2:
            first.receive(data)
            second.receive(data)
    second.end()
    _is_sound(knowledge)


def _is_sound(knowledge: Knowledge) -> None:
    """What is held is a path and a map, and not too much."""
    if knowledge.path.shape[1:] != (3,) or not np.isfinite(knowledge.path).all():
        raise AssertionError("a path that is none")
    mirror = knowledge.mirror
    if mirror is not None:
        mirror.digest()
        mirror.cells("known")
        if len(mirror) > MOST_BLOCKS + MAX_BLOCKS:
            raise AssertionError(f"{len(mirror)} blocks")
        if mirror.forgotten > MAX_FORGOTTEN + MAX_BLOCKS:
            raise AssertionError(f"{mirror.forgotten} orders of forgotten blocks")


def _server_survives(data: bytes) -> None:
    """Whatever a client says is a message or refused, and little of it is held back."""
    inbox = server_inbox()
    with contextlib.suppress(StreamError):
        inbox.feed(data)
        if len(inbox) > MAX_FROM_CLIENT + 4:
            raise AssertionError(f"{len(inbox)} bytes are held back")


def _blocks_are_blocks(data: bytes, *, counts: bool) -> None:
    """Any columns are blocks of the right shape or refused."""
    try:
        blocks = decode_blocks(zstandard.compress(data), counts=counts)
    except StreamError:
        return
    number = len(blocks)
    if number > MAX_BLOCKS or blocks.cells.shape != (number, CELLS):
        raise AssertionError(f"{number} blocks")
    if number and abs(blocks.keys.astype("i8")).max() >= MAX_KEY:
        raise AssertionError("a key beyond the reach")


def one_input(data: bytes) -> None:
    """Everything that is promised of any bytes."""
    if not data:
        return
    choice, said = data[0], data[1:]
    _client_survives(said, choice)
    _client_survives(len(said).to_bytes(4, "big") + said, choice)
    _client_survives_beside(said, choice)
    _client_survives_beside(len(said).to_bytes(4, "big") + said, choice)
    _server_survives(said)
    _server_survives(len(said).to_bytes(4, "big") + said)
    _blocks_are_blocks(said, counts=bool(choice & 1))


def main() -> None:
    """Hand over to libFuzzer."""
    # And not at import: an editable install hides its imports from atheris.
    atheris.instrument_all()
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
