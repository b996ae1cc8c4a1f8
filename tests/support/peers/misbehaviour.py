"""Faults of a link, reproducible in every run."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Misbehaviour:
    """A bad link.

    Attributes:
        drop: part of the messages that are lost.
        garble: share of the messages with one changed byte.
        noise: part of the messages that have line noise before them.
        max_bytes: a stream is cut into pieces of 1 to so many bytes; 0 leaves messages whole.
        stall_from: from this message on, nothing comes ...
        stall_for: ... until so many have gathered, which then come in one piece.
        seed: of all chance.
    """

    drop: float = 0.0
    garble: float = 0.0
    noise: float = 0.0
    max_bytes: int = 0
    stall_from: int = 0
    stall_for: int = 0
    seed: int = 1

    def pieces(self, messages: Iterable[bytes]) -> Iterator[bytes]:
        """Yield the received pieces; a stall is a series of empty pieces."""
        chance = np.random.default_rng(self.seed)
        held = b""
        for number, message in enumerate(messages):
            held += self._spoilt(message, chance)
            if self.stall_from <= number < self.stall_from + self.stall_for:
                yield b""
                continue
            yield from self._split(held, chance)
            held = b""
        yield from self._split(held, chance)

    def _spoilt(self, message: bytes, chance: np.random.Generator) -> bytes:
        if chance.random() < self.drop:
            return b""
        if chance.random() < self.garble:
            place = int(chance.integers(len(message)))
            changed = message[place] ^ int(chance.integers(1, 256))
            message = message[:place] + bytes([changed]) + message[place + 1 :]
        before = b""
        if chance.random() < self.noise:
            before = chance.bytes(int(chance.integers(1, 40)))
        return before + message

    def _split(self, data: bytes, chance: np.random.Generator) -> Iterator[bytes]:
        while self.max_bytes and data:
            size = int(chance.integers(1, self.max_bytes + 1))
            yield data[:size]
            data = data[size:]
        if data:
            yield data
