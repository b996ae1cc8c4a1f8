"""Which files of a log go, and when: decisions without files."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.errors import RecordingError
from oculus_driver.recording.log_files import MIB, LogFile, LogPolicy, make_room

PLENTY = 1 << 50


def files(*sizes: int) -> list[LogFile]:
    return [LogFile(number, f"f{number}", size) for number, size in enumerate(sizes)]


def test_a_file_is_full_by_size_or_time() -> None:
    policy = LogPolicy(max_file_bytes=MIB, max_file_ns=60 * 10**9)
    assert policy.full(MIB - 1, 0) is None
    assert policy.full(MIB, 0) == "size"
    assert policy.full(0, 60 * 10**9 - 1) is None
    assert policy.full(0, 60 * 10**9) == "time"
    assert LogPolicy().full(0, 10**18) is None


@pytest.mark.parametrize(
    "limits",
    [
        {"max_file_bytes": 5},
        {"max_file_ns": 5},
        {"budget_bytes": MIB},
        {"free_floor_bytes": -1},
        {"retry_ns": -1},
        {"sync_interval_ns": -1},
    ],
)
def test_limits_that_cannot_be_are_refused(limits: dict[str, Any]) -> None:
    with pytest.raises(RecordingError):
        LogPolicy(**limits)


def test_the_oldest_files_go_for_the_budget() -> None:
    policy = LogPolicy(max_file_bytes=MIB, budget_bytes=2 * MIB, free_floor_bytes=0)
    old = files(MIB // 2, MIB // 2, MIB // 2)
    room = make_room(policy, reversed(old), MIB // 2, 1, PLENTY)
    assert (room.delete, room.shortage) == ((old[0],), None)
    assert make_room(policy, old, 0, 1, PLENTY).delete == ()
    room = make_room(policy, old, 2 * MIB, 1, PLENTY)
    assert (room.delete, room.shortage) == (tuple(old), "budget")


def test_the_oldest_files_go_for_the_free_space() -> None:
    policy = LogPolicy(max_file_bytes=MIB, free_floor_bytes=1000)
    old = files(300, 300, 300)
    assert make_room(policy, old, 0, 100, 1100).delete == ()
    room = make_room(policy, old, 0, 100, 1099)
    assert (room.delete, room.shortage) == ((old[0],), None)
    room = make_room(policy, old, 0, 100, 0)
    assert (room.delete, room.shortage) == (tuple(old), "free_space")


@given(
    sizes=st.lists(st.integers(0, MIB), max_size=12),
    open_bytes=st.integers(0, 3 * MIB),
    needed=st.integers(0, MIB),
    free=st.integers(0, 8 * MIB),
)
def test_limits_hold_or_the_shortage_is_reported_and_nothing_goes_without_need(
    sizes: list[int], open_bytes: int, needed: int, free: int
) -> None:
    policy = LogPolicy(max_file_bytes=MIB, budget_bytes=3 * MIB, free_floor_bytes=2 * MIB)
    old = files(*sizes)
    room = make_room(policy, old, open_bytes, needed, free)

    def fits(deleted: int) -> bool:
        gone = sum(sizes[:deleted])
        within = sum(sizes) - gone + open_bytes + needed <= 3 * MIB
        return within and free + gone - needed >= 2 * MIB

    count = len(room.delete)
    assert room.delete == tuple(old[:count])
    assert fits(count) == (room.shortage is None)
    assert not any(fits(fewer) for fewer in range(count))
