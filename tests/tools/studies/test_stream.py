"""The study's own judge: how old a map is, and what a bad link does."""

import numpy as np
import pytest
from studies.stream.link import LinkShape, ShapedLink
from studies.stream.staleness import Knowledge, staleness

SECOND = 10**9


def reported(*rows: tuple[float, int, int], late_s: float = 0.0) -> Knowledge:
    """Rows of (time in seconds, x of the block, its content), received after they were valid."""
    times = np.array([round((time_s + late_s) * SECOND) for time_s, _, _ in rows], np.int64)
    keys = np.array([(x, 0, 0) for _, x, _ in rows], np.int32).reshape(-1, 3)
    digests = np.array([content for _, _, content in rows], np.int64)
    return Knowledge(times, keys, digests, times - round(late_s * SECOND))


def ages(reference: Knowledge, judged: Knowledge, *moments_s: float) -> tuple[list[float], ...]:
    moments = np.array([round(moment_s * SECOND) for moment_s in moments_s], np.int64)
    places = np.zeros((len(moments), 3))
    found = staleness(reference, judged, moments, places, radius_m=10.0, block_m=1.0)
    return found.near_s.tolist(), found.far_s.tolist()


def test_a_block_is_as_old_as_the_first_change_that_was_missed() -> None:
    reference = reported((1, 0, 11), (2, 0, 12), (3, 0, 13))
    assert ages(reference, reported((1, 0, 11)), 1.5, 2.5, 4.0)[0] == pytest.approx([0, 0.5, 2.0])


def test_what_was_never_reported_is_as_old_as_the_block() -> None:
    assert ages(reported((1, 0, 11), (2, 0, 12)), reported(), 0.5, 4.0)[0] == pytest.approx(
        [0, 3.0]
    )


def test_a_content_that_comes_again_is_the_newest_of_its_kind() -> None:
    reference = reported((1, 0, 11), (2, 0, 12), (5, 0, 11))
    assert ages(reference, reported((1, 0, 11)), 2.5, 6.0)[0] == pytest.approx([0.5, 0])


def test_what_the_reference_was_never_reported_is_as_old_as_the_daemon_reports() -> None:
    reference = reported((1, 0, 11), (2, 0, 12), (4, 0, 14))
    judged = reported((3.0, 0, 99), late_s=0.5)  # read between two messages of the reference
    assert ages(reference, judged, 3.8, 6.0)[0] == pytest.approx([0, 2.0])


def test_what_went_back_unseen_by_the_reference_is_as_old_as_the_daemon_reports() -> None:
    reference = reported((1, 0, 11), (2, 0, 12), (4, 0, 14))
    judged = reported((3.0, 0, 11), late_s=0.5)
    assert ages(reference, judged, 3.8, 6.0)[0] == pytest.approx([0, 2.0])


def test_near_and_far_are_distinguished() -> None:
    reference = reported((1, 9, 1), (1, 12, 2))
    near, far = ages(reference, reported((1.1, 9, 1)), 3.0)
    assert (near, far) == ([0.0], [2.0])


def test_packets_wait_for_their_turn_and_for_the_wire() -> None:
    link = ShapedLink(LinkShape(bits_per_s=8000, delay_s=0.3, loss=0.0, queue_bytes=2500), 1)
    assert link.arrives_s(0.0, 1000) == pytest.approx(1.3)
    assert link.arrives_s(0.5, 1000) == pytest.approx(2.3)
    assert link.arrives_s(0.5, 1500) is None  # there is no room
    assert link.arrives_s(5.0, 1000) == pytest.approx(6.3)
    assert (link.overflowed, link.bytes) == (1, 3000)


def test_so_many_packets_are_lost() -> None:
    link = ShapedLink(LinkShape(bits_per_s=1e9, loss=0.05), 1)
    arrived = [link.arrives_s(float(k), 100) is not None for k in range(10_000)]
    assert 9_400 < sum(arrived) < 9_600
    assert link.lost == 10_000 - sum(arrived)
