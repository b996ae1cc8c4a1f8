"""Damaged copies of recordings: one cut at any byte, one with bytes flipped."""

import shutil
from pathlib import Path

import msgspec
import numpy as np

MIDDLE = (0.3, 0.7)
"""Of the file, in which damage is done: some is always before it, and some behind."""

FLIPS = 20
PIECE = 1 << 20


class Damage(msgspec.Struct, frozen=True):
    """What was done to a copy.

    Attributes:
        copy: its path.
        kind: `cut` or `flips`.
        places: bytes from the file's start: of the cut, or of each flipped byte, sorted.
    """

    copy: Path
    kind: str
    places: tuple[int, ...]


def cut(recording: Path, copy: Path, seed: int) -> Damage:
    """Copy what comes before a random byte."""
    generator = np.random.default_rng([seed, 3])
    place = int(generator.uniform(*MIDDLE) * recording.stat().st_size)
    copy.parent.mkdir(parents=True, exist_ok=True)
    with recording.open("rb") as source, copy.open("wb") as out:
        left = place
        while piece := source.read(min(left, PIECE)):
            out.write(piece)
            left -= len(piece)
    return Damage(copy, "cut", (place,))


def flip(recording: Path, copy: Path, seed: int, flips: int = FLIPS) -> Damage:
    """Copy all, and invert all bits of random bytes."""
    generator = np.random.default_rng([seed, 4])
    low, high = (int(part * recording.stat().st_size) for part in MIDDLE)
    places = sorted(int(p) for p in generator.choice(high - low, size=flips, replace=False) + low)
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(recording, copy)
    with copy.open("r+b") as file:
        for place in places:
            file.seek(place)
            byte = file.read(1)[0]
            file.seek(place)
            file.write(bytes([byte ^ 0xFF]))
    return Damage(copy, "flips", tuple(places))
