from types import SimpleNamespace
from typing import Any

from mapperd.daemon.status import Watch
from mapperd.events import EventLog
from mapperd.pipeline.counters import PipelineCounters


def snapshot(*, refused: int = 0, late: bool = False) -> Any:
    return SimpleNamespace(
        localization=None,
        behind={"late": late, "dropped": 0},
        pings={"dropped": {"fan_too_large": refused} if refused else {}},
    )


def test_refused_pings_are_reported_with_their_reason_and_not_one_by_one() -> None:
    reason = "a swath of 90 m holds 2e+09 voxels"
    counters = PipelineCounters(first_drop={"fan_too_large": reason})
    live: Any = SimpleNamespace(counters=counters)
    events = EventLog(lambda: 0)
    watch = Watch(events, live)
    for refused in range(1000):
        watch.update(snapshot(refused=refused))
    reported = events.since(0)[0]
    assert {one.code for one in reported} == {"pings_refused"}
    assert reason in reported[0].text
    assert [one.facts["pings"] for one in reported][:3] == [1, 3, 7]
    assert len(reported) < 12
