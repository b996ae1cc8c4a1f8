"""How old a client's map was, judged by what another client, on a good link, knew when."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Knowledge", "Staleness", "staleness"]

Times = NDArray[np.int64]

AHEAD_NS = 1_000_000_000
"""So much earlier than the reference the judged client may have received something."""


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What a client received, in the order of the times.

    Attributes:
        times_ns: (N,) int64.
        keys: (N, 3) int32, the block of which it was.
        digests: (N,) int64, of the block's content from then on.
        stamps_ns: (N,) when it was so, by the daemon.
    """

    times_ns: Times
    keys: NDArray[np.int32]
    digests: NDArray[np.int64]
    stamps_ns: Times


@dataclass(frozen=True, slots=True, eq=False)
class Staleness:
    """At moments: the age of the oldest content within the radius, and beyond it.

    Attributes:
        times_ns: (M,).
        near_s, far_s: (M,) 0 where all is as the reference has it.
        near_blocks: (M,) that the reference knew within the radius.
    """

    times_ns: Times
    near_s: NDArray[np.float64]
    far_s: NDArray[np.float64]
    near_blocks: NDArray[np.int64]


def staleness(
    reference: Knowledge,
    judged: Knowledge,
    moments_ns: Times,
    places_m: NDArray[np.float64],
    *,
    radius_m: float,
    block_m: float,
) -> Staleness:
    """The age of a client's map.

    A block is as old as the time since the reference first received something that the client has
    not got: the first change after the one whose content the client holds. A content that comes
    again (a cell that goes back) counts as the newest time it was so, in the client's favour. One
    that was read between two messages of the reference, which never received it, or received the
    same long before, is as old as the daemon reports.

    Args:
        reference: receives everything at once.
        judged: on the bad link.
        moments_ns: (M,) ascending.
        places_m: (M, 3) of the vehicle at them.
        radius_m: of what is near, to the nearest corner or face of a block.
        block_m: edge of a block.
    """
    truth, known = _by_block(reference), _by_block(judged)
    keys = np.array(list(truth), np.int64).reshape(-1, 3)
    ages_s = np.zeros((len(keys), len(moments_ns)))
    exists = np.zeros((len(keys), len(moments_ns)), bool)
    for row, key in enumerate(truth):
        ages_s[row], exists[row] = _ages(truth[key], known.get(key), moments_ns)
    near = np.stack([_within(keys, place, radius_m, block_m) for place in places_m], axis=1)
    return Staleness(
        moments_ns,
        np.where(near & exists, ages_s, 0).max(axis=0, initial=0),
        np.where(~near & exists, ages_s, 0).max(axis=0, initial=0),
        (near & exists).sum(axis=0),
    )


Key = tuple[int, int, int]
History = tuple[Times, NDArray[np.int64], Times]


def _by_block(knowledge: Knowledge) -> dict[Key, History]:
    held: dict[Key, list[tuple[int, int, int]]] = {}
    rows = zip(
        map(tuple, knowledge.keys.tolist()),
        knowledge.times_ns.tolist(),
        knowledge.digests.tolist(),
        knowledge.stamps_ns.tolist(),
        strict=True,
    )
    for key, time_ns, digest, stamp_ns in rows:
        held.setdefault(key, []).append((time_ns, digest, stamp_ns))
    return {key: _columns(received) for key, received in held.items()}


def _columns(received: list[tuple[int, int, int]]) -> History:
    times, digests, stamps = np.array(received, np.int64).T
    return times, digests, stamps


def _ages(
    truth: History, known: History | None, moments_ns: Times
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The block's age at each moment, and whether the reference knew it then."""
    times, digests, stamps = truth
    newest = np.searchsorted(times, moments_ns, side="right") - 1
    ages = np.zeros(len(moments_ns))
    for at, (moment, last) in enumerate(zip(moments_ns, newest, strict=True)):
        if last < 0:
            continue
        digest, stamp_ns = _held(known, int(moment))
        received = int(np.searchsorted(times, moment + AHEAD_NS, side="right"))
        same = np.nonzero(digests[:received] == digest)[0]
        missed = int(np.searchsorted(stamps, stamp_ns, "right"))
        missed = max(missed, int(same[-1]) + 1) if len(same) else missed
        if missed <= last:
            ages[at] = (moment - times[missed]) / 1e9
    return ages, newest >= 0


def _held(known: History | None, moment: int) -> tuple[int, int]:
    """Digest and stamp of the content held at a moment; -1 before there was any."""
    if known is None:
        return -1, -1
    at = int(np.searchsorted(known[0], moment, side="right")) - 1
    return (-1, -1) if at < 0 else (int(known[1][at]), int(known[2][at]))


def _within(
    keys: NDArray[np.int64], place_m: NDArray[np.float64], radius_m: float, block_m: float
) -> NDArray[np.bool_]:
    low = keys * block_m
    nearest = np.clip(place_m, low, low + block_m)
    within: NDArray[np.bool_] = ((nearest - place_m) ** 2).sum(axis=1) <= radius_m**2
    return within
