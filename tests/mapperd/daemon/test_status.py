from types import SimpleNamespace
from typing import Any

from mapperd.daemon.status import Watch
from mapperd.events import EventLog
from mapperd.pipeline.counters import PipelineCounters
from tests.support.process import resident_bytes


def snapshot(*, refused: int = 0, late: bool = False) -> Any:
    return SimpleNamespace(
        localization=None,
        behind={"late": late, "dropped": 0},
        pings={"dropped": {"fan_too_large": refused} if refused else {}},
    )


def test_refused_pings_are_reported_with_their_reason_and_not_one_by_one() -> None:
    counters = PipelineCounters(first_drop={"fan_too_large": "a swath of 90 m holds 2e+09 voxels"})
    live: Any = SimpleNamespace(counters=counters)
    events = EventLog(lambda: 0)
    watch = Watch(events, live)
    for refused in range(1000):
        watch.update(snapshot(refused=refused))
    reported = events.since(0)[0]
    assert {one.code for one in reported} == {"pings_refused"}
    assert reported[0].text == "pings are refused: a swath of 90 m holds 2e+09 voxels"
    assert [one.facts["pings"] for one in reported][:3] == [1, 3, 7]
    assert len(reported) < 12


def test_memory_of_a_backlog_is_returned_once_mapping_has_caught_up() -> None:
    live: Any = SimpleNamespace(counters=PipelineCounters())
    watch = Watch(EventLog(lambda: 0), live)
    watch.update(snapshot(late=True))
    waiting = [bytes([n % 251]) * 40_000 for n in range(2500)]  # 100 MB, with what stays between
    kept = waiting[::50]
    before = resident_bytes()
    del waiting
    watch.update(snapshot(late=False))
    assert resident_bytes() < before - 80_000_000
    assert len(kept) == 50
