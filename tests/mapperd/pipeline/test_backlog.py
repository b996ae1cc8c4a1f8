import itertools
from collections.abc import Callable

import pytest

from mapperd.config.daemon import BacklogConfig
from mapperd.errors import Reject
from mapperd.geometry.frames import pose_from_rpy
from mapperd.pipeline.backlog import Backlog
from mapperd.pipeline.decoder import PosedPing
from mapperd.pipeline.pose_lookup import FixedPose
from mapperd.session_log import Reset
from oculus_driver.ping import Ping

MakePing = Callable[..., Ping]
S = 1_000_000_000


@pytest.fixture
def settled(ping: MakePing) -> Callable[..., PosedPing]:
    numbers = itertools.count()

    def make(*, posed: bool = True) -> PosedPing:
        poses = FixedPose(pose_from_rpy((0, 0, 0), (0, 0, 0)))
        poses.add_ping(ping())
        ((one, pose),) = poses.resolved(None)
        return PosedPing(next(numbers), one, pose if posed else Reject("no_odometry", ""), None)

    return make


def test_ping_that_waited_too_long_is_dropped_while_newer_ones_wait(
    settled: Callable[..., PosedPing],
) -> None:
    backlog = Backlog(BacklogConfig(max_wait=1.0))
    for t_s in (0.0, 0.2, 0.4):
        backlog.put(settled(), round(t_s * S))
    turns = [backlog.next(round(1.3 * S)) for _ in range(3)]
    assert [dropped for _, dropped in turns] == [True, True, False]
    assert (backlog.dropped, backlog.late, len(backlog)) == (2, True, 0)


def test_newest_ping_is_mapped_however_long_it_waited(settled: Callable[..., PosedPing]) -> None:
    backlog = Backlog(BacklogConfig(max_wait=1.0))
    backlog.put(settled(), 0)
    assert not backlog.next(100 * S)[1]


def test_order_and_a_ping_without_pose_cost_nothing_and_are_never_dropped(
    settled: Callable[..., PosedPing],
) -> None:
    backlog = Backlog(BacklogConfig(max_wait=1.0))
    backlog.put(Reset(1), 0)
    backlog.put(settled(posed=False), 0)
    backlog.put(settled(), 0)
    assert backlog.pings == 1
    assert not any(backlog.next(9 * S)[1] for _ in range(3))


def test_backlog_is_late_until_it_has_caught_up(settled: Callable[..., PosedPing]) -> None:
    backlog = Backlog(BacklogConfig(max_wait=1.0))
    seen = []
    for wait_s in (0.9, 1.1, 0.3, 0.05):
        backlog.put(settled(), 0)
        backlog.put(settled(posed=False), 0)
        backlog.put(settled(), 0)
        seen.append((backlog.next(round(wait_s * S))[1], backlog.late))
        for _ in range(2):
            backlog.next(0, patient=True)
    assert seen == [(False, False), (True, True), (False, True), (False, False)]


def test_images_that_wait_are_bounded(
    settled: Callable[..., PosedPing], monkeypatch: pytest.MonkeyPatch
) -> None:
    backlog = Backlog(BacklogConfig(max_wait=60))
    works = [settled() for _ in range(4)]
    monkeypatch.setattr("mapperd.pipeline.backlog.MAX_BYTES", works[0].ping.image.nbytes)
    for work in works:
        backlog.put(work, 0)
    assert [backlog.next(0)[1] for _ in range(4)] == [True, True, False, False]


def test_at_the_end_everything_is_mapped(settled: Callable[..., PosedPing]) -> None:
    backlog = Backlog(BacklogConfig(max_wait=1.0))
    for _ in range(3):
        backlog.put(settled(), 0)
    assert not any(backlog.next(9 * S, patient=True)[1] for _ in range(3))
