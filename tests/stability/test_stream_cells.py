"""Hard cases of the map stream: cells, their quantisation and their places."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from mpmath import mpf

from mapperd import _core
from mapperd.client.mirror import MapMirror
from mapperd.server.map_index import BlockIndex, distances_m, within
from mapperd.wire.blocks import CELLS, MAX_KEY, UNKNOWN, BlockSet, decode_blocks, encode_blocks
from mapperd.wire.framing import StreamError
from mapperd.wire.messages import Interest, MapInfo
from tests.stability.iwlo_oracle import sigmoid

OCCUPIED, FREE = math.log(0.7 / 0.3), math.log(0.4 / 0.6)
WIDE = _core.IwloParams(L_min=-127.0, L_max=127.0)
USUAL, UNIT = _core.IwloParams(), 2.0**-11
"""The default rule, and in what a map of it holds log-odds."""

ORIGIN = np.zeros((1, 3), np.int32)


def facts(step: float, occupied: float = OCCUPIED, free: float = FREE) -> MapInfo:
    return MapInfo("m", 0.1, step, occupied, free)


def view(step: float, level: int = 0, detail: str = "log_odds") -> _core.StreamView:
    return _core.StreamView(
        level, detail, log_odds_step=step, occupied_log_odds=OCCUPIED, free_log_odds=FREE
    )


def voxels_of(
    values: np.ndarray, rule: _core.IwloParams = WIDE
) -> tuple[_core.VoxelMap, np.ndarray]:
    """A map of these log-odds along x, and the points at which they are."""
    voxels = _core.VoxelMap(0.1, rule)
    points = np.zeros((len(values), 3)) + 0.05
    points[:, 0] += 0.1 * np.arange(len(values))
    voxels.set_log_odds(points, values)
    return voxels, points


def mirrored(voxels: _core.VoxelMap, step: float, level: int = 0) -> MapMirror:
    """Return the state of a client that received everything."""
    keys = np.array(list(itertools.product(range(-2, 3), repeat=3)), np.int32)
    _, cells, counts, _ = voxels.stream_blocks(view(step, level, "counts"), keys)
    ages = np.zeros(len(keys), np.uint32)
    mirror = MapMirror(facts(step), Interest(level=level, detail="counts"))
    body = encode_blocks(BlockSet(keys, ages, cells, counts))
    mirror.put(decode_blocks(body, counts=True), 0)
    return mirror


@pytest.mark.parametrize("step", [1e-6, 0.01, 0.25, 0.5, 1.0])
def test_a_voxel_a_unit_beyond_a_threshold_is_sent_on_its_side(step: float) -> None:
    """The client's classes are the map's, although it receives log-odds in coarse steps.

    Naively log-odds are rounded to the nearest step, which lies on the other side of the threshold:
    the pilot sees water where the map has a wall.
    """
    units = np.array([-3, -2, -1, 0, 1, 2, 3]) * UNIT
    limits = np.round(np.array([OCCUPIED, FREE]) / UNIT) * UNIT
    values = np.concatenate([limits[0] + units, limits[1] + units])
    voxels, points = voxels_of(values, USUAL)
    assert (voxels.query(points)[0] == values).all()
    sent = mirrored(voxels, step).classify(points)
    expected = voxels.classify(points, OCCUPIED, FREE)
    assert (expected == np.where(values > OCCUPIED, 1, np.where(values < FREE, 0, -1))).all()
    assert set(expected.tolist()) == {-1, 0, 1}
    reached = 127 * step > OCCUPIED  # of so fine a step no multiple lies beyond the thresholds
    assert (sent == (expected if reached else -1)).all()


def test_a_client_is_off_by_half_a_step_and_beside_a_threshold_by_less_than_one() -> None:
    """A client computes with what it received, within the error that the page states.

    Naively half a step is stated as the bound: 0.125. Beside a threshold the class has precedence,
    and the nearest step on its side is 0.155 away.
    """
    values = np.arange(-4.0, 4.0, UNIT)  # all that the map can hold there
    voxels, off, p_off = _core.VoxelMap(0.1, USUAL), [], []
    for eight in np.split(values, np.arange(8, len(values), 8)):
        points = np.zeros((len(eight), 3)) + 0.05
        points[:, 0] += 0.1 * np.arange(len(eight))
        voxels.set_log_odds(points, eight)
        sent = 0.25 * voxels.stream_blocks(view(0.25), ORIGIN)[1][0, : len(eight)]
        off.append(np.abs(sent - eight))
        p_off.append(np.abs(1 / (1 + np.exp(-sent)) - 1 / (1 + np.exp(-eight))))
    limits = np.array([OCCUPIED, FREE])
    away = np.abs(values[:, None] - limits).min(axis=1)
    assert np.concatenate(off)[away > 0.125].max() <= 0.125
    assert np.concatenate(off).max() == pytest.approx(0.155, abs=5e-4)
    assert np.concatenate(p_off).max() == pytest.approx(0.038, abs=5e-4)


def test_the_ends_of_log_odds_are_sent_as_such_and_not_as_unknown() -> None:
    """Cells are bytes, with -128 for unknown: certain water must not become that.

    Naively -127 / 0.25 is cut off to eight bits: 4, which is occupied, and -32 / 0.25 is unknown.
    """
    values = np.array([-127.0, -64.0, -32.0, -31.75, 31.75, 32.0, 64.0, 127.0])
    voxels, _ = voxels_of(values)
    for step, expected in ((0.25, 127), (1e-6, 127), (1.0, None)):
        _, cells, _, _ = voxels.stream_blocks(view(step), ORIGIN)
        sent = cells[0, :8].astype(int)
        assert (np.sign(sent) == np.sign(values)).all()
        assert UNKNOWN not in sent
        if expected is not None:
            assert (np.abs(sent) == expected).all()


def test_halves_of_a_step_do_not_lean_to_one_side() -> None:
    """A voxel half way between two steps goes to the even one, up or down.

    Naively floor(x + 0.5) moves all of them up: free water fades and walls grow, by a half step
    in each voxel that one observation of a round setting made.
    """
    values = (np.arange(8) + 6.5) * 0.25
    up, _ = voxels_of(values)
    down, _ = voxels_of(-values)
    sent_up = up.stream_blocks(view(0.25), ORIGIN)[1][0, :8].astype(int)
    sent_down = down.stream_blocks(view(0.25), ORIGIN)[1][0, :8].astype(int)
    assert (sent_up == -sent_down).all()
    assert (sent_up == np.round(values / 0.25)).all()
    assert (sent_up - values / 0.25).sum() == 0


def test_probabilities_of_a_mirror_are_finite_at_the_surest_cells() -> None:
    """Cells go up to 127 steps, of up to 10: log-odds of 1270.

    Naively exp(-L) is worked out in the cells' single precision, which ends at 88: it overflows for
    water that is sure to be free.
    """
    for step in (0.25, 1.0, 10.0):
        cells = np.full((1, CELLS), UNKNOWN, np.int8)
        cells[0, :255] = np.arange(-127, 128)
        mirror = MapMirror(facts(step), Interest())
        mirror.put(BlockSet(ORIGIN, np.zeros(1, np.uint32), cells), 0)
        known = mirror.cells("known")
        exact = [float(sigmoid(mpf(float(value)))) for value in known.log_odds]
        assert known.probability.astype(np.float64) == pytest.approx(exact, rel=1e-6, abs=1e-38)


def test_a_coarse_cell_left_of_zero_holds_its_own_voxels() -> None:
    """At level 3 a cell is 8 voxels wide, and those from -8 to -1 are one.

    Naively their indices are divided towards zero: -7 to 7 are one cell, 15 wide.
    """
    for level in range(4):
        edge = 0.1 * 2**level
        voxels = _core.VoxelMap(0.1, WIDE)
        voxels.set_log_odds(np.array([[-0.05, -0.05, -0.05]]), np.array([3.0]))
        (centre,) = mirrored(voxels, 0.25, level).cells("known").centres_m.tolist()
        assert centre == pytest.approx([-edge / 2] * 3)


def test_a_count_of_65535_is_sent_within_a_factor_of_two() -> None:
    """Counts are sent as their number of bits, up to 16, and become 16 bits again.

    Naively 1 << 16 is made of it, which is 0 in 16 bits: what was seen most was never seen.
    """
    rule = _core.IwloParams(decay_rate=1.0, min_alpha=1 / 65536)
    voxels = _core.VoxelMap(0.1, rule)
    many = np.full((66_000, 3), 0.05)
    voxels.observe(many, np.full(66_000, 255.0), np.ones(66_000, bool))
    assert voxels.voxels()[2].tolist() == [65535]
    assert mirrored(voxels, 0.25).cells("known").count.tolist() == [32768]


def test_blocks_at_the_end_of_all_keys_come_back_and_those_beyond_are_refused() -> None:
    """Keys are bounded by 2**30, and a hostile one may be the least number of 32 bits.

    Naively its absolute value is compared, which is itself: -2**31 has no positive.
    """
    cells = np.full((2, CELLS), 5, np.int8)
    ages = np.array([0, 2**32 - 1], np.uint32)
    last = np.array([[MAX_KEY - 1] * 3, [1 - MAX_KEY] * 3], np.int32)
    back = decode_blocks(encode_blocks(BlockSet(last, ages, cells)), counts=False)
    assert (back.keys == last).all()
    assert (back.ages_ms == ages).all()
    for bad in (-(2**31), MAX_KEY, -MAX_KEY):
        keys = np.array([[0, bad, 0], [1, 1, 1]], np.int32)
        with pytest.raises(StreamError, match="reach"):
            decode_blocks(encode_blocks(BlockSet(keys, ages, cells)), counts=False)


def test_a_block_that_is_50_days_old_is_not_new() -> None:
    """Ages are milliseconds in 32 bits, which end after 49.7 days; a block then is as old as that.

    Naively the age starts again at 0, or its nanoseconds overflow 32 bits in the client: the block
    seems to have changed just now.
    """
    stamp_ns = 1_800_000_000 * 10**9
    mirror = MapMirror(facts(0.25), Interest())
    cells = np.full((1, CELLS), 4, np.int8)
    mirror.put(BlockSet(ORIGIN, np.array([2**32 - 1], np.uint32), cells), stamp_ns)
    changed_ns = int(mirror.cells("known").changed_ns[0])
    assert stamp_ns - changed_ns == (2**32 - 1) * 10**6


def test_distances_of_blocks_are_right_ten_thousand_kilometres_out() -> None:
    """Blocks near the vehicle are sent first, wherever on Earth the map has its origin.

    Naively places are held in single precision, whose step is a metre at 1e7 m, or keys are
    multiplied by lengths in their 32 bits.
    """
    block_m = 0.4
    keys = np.array([[25_000_000, -25_000_000, 0], [25_000_003, -25_000_000, 0]], np.int32)
    here = (1e7 + 0.2, -1e7 + 0.2, 0.2)
    assert distances_m(keys, block_m, here) == pytest.approx([0.0, 1.0], abs=1e-8)
    interest = Interest(radius_m=0.9)
    held = np.zeros(2, bool)
    assert within(keys, block_m, interest, here, held).tolist() == [True, False]


def test_revisions_beyond_2_to_the_53_are_distinguished() -> None:
    """A map's revision counts up for good, and what changed since one is asked by it.

    Naively revisions meet a signed number and become doubles, of which those beyond 2**53 are even:
    the last change is not sent.
    """
    for start in (2**53, 2**62, 2**63 + 5):
        voxels = _core.VoxelMap(0.1, WIDE)
        voxels.raise_revision(start)
        index = BlockIndex(0, view(0.25), 0.1)
        for number in range(3):
            before = voxels.revision
            voxels.set_log_odds(np.array([[10.0 * number, 0.0, 0.0]]), np.array([3.0]))
            assert voxels.revision == before + 1
            revision, _, blocks, revisions, _ = voxels.changed_blocks(before, ORIGIN[:0])
            assert revision == before + 1
            assert revisions.tolist() == [before + 1]
            index.note_blocks(blocks)
            index.work(voxels, None, 100)
            assert int(index.revisions[: len(index)].max()) == before + 1


def test_a_block_of_unknown_cells_has_no_digest_and_others_never_share_that() -> None:
    """The digest 0 means that nothing is known; a known block must not get it by chance.

    Naively a sum of cells is the digest: cells of log-odds 0, observed and uncertain, add up to
    nothing, and are never sent.
    """
    values = np.zeros(512)
    voxels, _ = voxels_of(values[:8])
    keys = np.array([[0, 0, 0], [5, 5, 5]], np.int32)
    digests, _, _ = voxels.stream_digests(view(0.25), keys)
    assert digests[0] != 0
    assert digests[1] == 0
    swapped, _ = voxels_of(np.array([1.0, -1.0, 0, 0, 0, 0, 0, 0]))
    other, _ = voxels_of(np.array([-1.0, 1.0, 0, 0, 0, 0, 0, 0]))
    a, b = (one.stream_digests(view(0.25), ORIGIN)[0][0] for one in (swapped, other))
    assert a != b


@pytest.mark.parametrize("step", [0.25, 2.0, 5.0])
def test_a_mirror_of_the_surest_cells_becomes_a_map(step: float) -> None:
    """127 log-odds sent in steps of 2 are 64 of them, 128, which no map holds.

    Naively the map that is made of the cells takes its clamps from them, and is refused.
    """
    voxels, points = voxels_of(np.array([127.0, -127.0, 1.0]))
    made = mirrored(voxels, step).to_map()
    expected = np.array([min(127 * step, 127.0), -min(127 * step, 127.0)])
    assert made.core.query(points[:2])[0] == pytest.approx(expected, abs=step / 2)


@pytest.mark.parametrize(("occupied", "free"), [(36.74, -36.74), (36.74, -744.0), (1e300, -1e300)])
def test_thresholds_at_the_ends_of_probability_are_those_of_the_map(
    occupied: float, free: float
) -> None:
    """A threshold of 1 - 1e-16 is log-odds of 36.7, and as a probability again it rounds to 1.

    Naively p / (1 - p) then divides by 0, and exp(744) overflows, in a client that saves its map.
    """
    mirror = MapMirror(facts(0.25, occupied, free), Interest())
    cells = np.full((1, CELLS), 4, np.int8)
    mirror.put(BlockSet(ORIGIN, np.zeros(1, np.uint32), cells), 0)
    counts = mirror.to_map().counts()
    assert (counts.occupied, counts.free, counts.uncertain) == (0, 0, CELLS)
