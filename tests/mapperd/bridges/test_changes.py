"""The watch for changes, and what the daemon makes of its reports."""

import asyncio
import json
import threading
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np
import pytest

from mapperd.api import ChangeReport, ReportedChanges
from mapperd.bridges.changes import ChangeTracker, MapWatch, in_memory, serve
from mapperd.cli.mapperctl.command import main
from mapperd.client.changes import ClientChange, MapChanged
from mapperd.client.mirror import MapMirror, map_of, names_of
from mapperd.client.validation import AskError
from mapperd.config.tree import ChangesConfig, Config, OctreeConfig
from mapperd.errors import MapError
from mapperd.events import EventLog
from mapperd.mapping.difference import MapChange, changes_among, changes_of, compare_maps
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.map_files import map_in
from mapperd.wire.blocks import CELLS, UNKNOWN, BlockSet
from mapperd.wire.messages import Interest, MapInfo
from mapperd.wire.requests import Fault, ReportRequest, decode_request
from tests.mapperd.bridges.bridge_fakes import BridgeStream, a_pose, a_status, beat, sure
from tests.support.waiting import until

INFO = MapInfo("one", 0.25, 0.25, 0.6, -0.6)
ALL = ChangesConfig(min_voxels=1, tolerance=0.0)


def cells_of(random: np.random.Generator, rows: int) -> np.ndarray:
    """Blocks of which most is free water, with something in it here and there."""
    cells = np.where(random.random((rows, CELLS)) < 0.7, -20, UNKNOWN).astype(np.int8)
    cells[random.random(cells.shape) < 0.02] = 30
    return cells


def known_and_live(seed: int) -> tuple[SonarMap, MapMirror, np.ndarray]:
    """A known map and a mirror that differs from it in places."""
    random = np.random.default_rng(seed)
    keys = np.stack(np.meshgrid(*[np.arange(-2, 2)] * 3), axis=-1).reshape(-1, 3).astype(np.int32)
    before = MapMirror(INFO, Interest())
    cells = cells_of(random, len(keys))
    before.put(BlockSet(keys, np.zeros(len(keys), np.uint32), cells), 1)
    known = map_of(before.cells("known"), 0.25, INFO)
    live = MapMirror(INFO, Interest())
    turned = random.random(cells.shape) < 0.03
    cells[turned & (cells != UNKNOWN)] *= -1
    live.put(BlockSet(keys, np.zeros(len(keys), np.uint32), cells), 1)
    return known, live, keys


@pytest.mark.parametrize("tolerance", [0.0, 0.25, 1.1])
def test_changes_block_by_block_are_those_of_the_whole_maps(tolerance: float) -> None:
    known, live, keys = known_and_live(1)
    watch = MapWatch(known, msgspec.structs.replace(ALL, tolerance=tolerance))
    order = np.random.default_rng(2).permutation(len(keys))
    for rows in np.array_split(order, 7):
        watch.update(live, names_of(keys[rows]))
    found = compare_maps(known, live.to_map(), tolerance or None)
    expected = changes_of(found)
    assert watch.changes() == expected
    if tolerance < 1:
        assert {one.kind for one in expected} == {"appeared", "vanished"}
        assert len(expected) > 20


def test_a_change_that_is_undone_is_gone() -> None:
    known, live, keys = known_and_live(3)
    watch = MapWatch(known, ALL)
    watch.update(live, names_of(keys))
    assert watch.changes()
    info = msgspec.structs.replace(INFO)
    cells = np.full((len(keys), CELLS), UNKNOWN, np.int8)
    live.begin(info, Interest())
    live.put(BlockSet(keys, np.zeros(len(keys), np.uint32), cells), 2)
    watch.update(live, names_of(keys))
    assert watch.changes() == []  # what is not seen again has not changed


def test_maps_of_other_resolutions_can_be_compared() -> None:
    """A wall that is known at 0.5 m is there at 0.25 m; a pile is new."""
    wall = np.stack(np.meshgrid([2.25], np.arange(0.25, 6, 0.5), [0.25, 0.75]), -1).reshape(-1, 3)
    free = np.stack(np.meshgrid(np.arange(0.25, 2, 0.5), np.arange(0.25, 6, 0.5), [0.25]), -1)
    known = SonarMap(Config(octree=OctreeConfig(voxel_resolution=0.5)))
    known.core.set_log_odds(wall, np.full(len(wall), 3.0))
    known.core.set_log_odds(free.reshape(-1, 3), np.full(free.size // 3, -3.0))
    live = MapMirror(INFO, Interest())
    cells = np.full((2, 8, 8, 8), UNKNOWN, np.int8)  # block, z, y, x
    cells[1, 0:4, :, 0:2] = 30  # the wall, at x 2.0 to 2.5
    cells[0, 1, 3, 4] = 30  # the pile, at (1.125, 0.875, 0.375)
    keys = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    live.put(BlockSet(keys, np.zeros(2, np.uint32), cells.reshape(2, CELLS)), 1)
    watch = MapWatch(known, msgspec.structs.replace(ALL, tolerance=0.6))
    watch.update(live, names_of(keys))
    (change,) = watch.changes()
    assert (change.kind, change.voxels) == ("appeared", 1)
    assert change.low_m[0] < 1.125 < change.high_m[0]


def test_a_tolerance_that_is_too_large_is_refused_at_once() -> None:
    known, _, _ = known_and_live(1)
    with pytest.raises(MapError, match="tolerance"):
        MapWatch(known, msgspec.structs.replace(ALL, tolerance=99.0))


def test_a_map_on_disk_is_read_once(tmp_path: Path) -> None:
    known, _, _ = known_and_live(4)
    known.save(tmp_path / "a.map")
    found = map_in(tmp_path / "a.map", Config()).map
    assert in_memory(found) is found


def box(kind: Any, x_m: float, voxels: int = 10) -> MapChange:
    return MapChange(kind, (x_m, 0.0, 0.0), (x_m + 1.0, 1.0, 1.0), voxels)


def test_a_change_is_reported_when_it_is_found_twice() -> None:
    tracker = ChangeTracker(0.5)
    assert tracker.update([box("appeared", 0.0)]) == ([], [])
    due, over = tracker.update([box("appeared", 0.1)])
    assert ([one.id for one in due], over) == (["appeared-1"], [])
    assert tracker.update([box("appeared", 0.0)]) == ([], [])
    assert [one.id for one in tracker.reported] == ["appeared-1"]
    assert tracker.update([]) == ([], ["appeared-1"])
    assert tracker.reported == []


def test_a_change_that_grows_is_reported_again_and_a_flicker_never() -> None:
    tracker = ChangeTracker(0.5)
    for _ in range(3):
        assert tracker.update([box("vanished", 9.0)]) == ([], [])
        assert tracker.update([]) == ([], [])
    for voxels in (10, 11):
        tracker.update([box("appeared", 0.0, voxels)])
    assert tracker.update([box("appeared", 0.0, 21)])[0] == []
    due, _ = tracker.update([box("appeared", 0.0, 22)])
    assert [one.voxels for one in due] == [22]


def test_changes_of_other_kinds_and_places_are_others() -> None:
    tracker = ChangeTracker(0.5)
    changes = [box("appeared", 0.0), box("vanished", 0.0), box("appeared", 3.0)]
    tracker.update(changes)
    due, _ = tracker.update(changes)
    assert len({one.id for one in due}) == 3


def report(kind: Any, name: str, voxels: int = 5) -> ChangeReport:
    return ChangeReport(kind, name, (0.0, 1.0, -2.0), (1.0, 2.0, -1.0), voxels)


def test_reports_are_events_and_kept() -> None:
    events, changes = EventLog(lambda: 5), ReportedChanges()
    changes.take([report("appeared", "a"), report("vanished", "b")], "old.map", events, begin=True)
    changes.take([report("appeared", "a", 9)], "old.map", events, begin=False)  # only larger
    found, _ = events.since(0)
    assert [(one.code, str(one.severity)) for one in found] == [
        ("appeared", "warning"),
        ("vanished", "notice"),
    ]
    assert found[0].facts["low_m"] == [0.0, 1.0, -2.0]
    assert "5 voxels at x 0.0 to 1.0, y 1.0 to 2.0, z -2.0 to -1.0 m" in found[0].text
    assert [(one["id"], one["voxels"]) for one in changes.plain()] == [("a", 9), ("b", 5)]
    changes.take([report("over", "a"), report("over", "none")], "old.map", events, begin=False)
    assert [one["id"] for one in changes.plain()] == ["b"]
    assert [one.code for one in events.since(2)[0]] == ["change_over"]


def test_a_new_beginning_forgets_without_new_events() -> None:
    events, changes = EventLog(lambda: 5), ReportedChanges()
    changes.take([report("appeared", "a"), report("appeared", "b")], "m", events, begin=True)
    changes.take([report("appeared", "b")], "m", events, begin=True)
    assert [one["id"] for one in changes.plain()] == ["b"]
    assert events.last == 2


def test_reports_are_bounded() -> None:
    events, changes = EventLog(lambda: 5), ReportedChanges()
    for number in range(300):
        changes.take([report("appeared", f"a{number}")], "m", events, begin=False)
    assert len(changes.plain()) == 200
    assert changes.plain()[-1]["id"] == "a299"


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "other", "id": "a"},
        {"kind": "appeared", "id": "a/b"},
        {"kind": "appeared", "id": ""},
        {"kind": "appeared", "id": "a", "low_m": [0, 0]},
        {"kind": "appeared", "id": "a", "low_m": [1e9, 0, 0]},
        {"kind": "appeared", "id": "a", "voxels": -1},
        {"kind": "appeared", "id": "a", "more": 1},
    ],
)
def test_an_invalid_report_is_refused(change: dict[str, Any]) -> None:
    asked = {"do": "report", "id": 1, "changes": [change]}
    request, _ = decode_request(msgspec.msgpack.encode(asked))
    assert isinstance(request, Fault)
    good = {"do": "report", "id": 1, "changes": [{"kind": "over", "id": "a"}]}
    assert isinstance(decode_request(msgspec.msgpack.encode(good))[0], ReportRequest)


class Watched:
    """A watch beside a fake daemon, which does not localize unless it is told so."""

    def __init__(self, known: SonarMap, mirror: MapMirror, *state: ClientChange) -> None:
        self.state = state or (a_status(),)
        self.stream = BridgeStream()
        self.stream.mirror = mirror
        self.lines: list[str] = []
        config = ChangesConfig(min_voxels=3, period=0.5, tolerance=0.0)
        self.work = serve(self.stream, known, "old.map", config, self.lines.append)

    async def __aenter__(self) -> Self:
        self._task = asyncio.create_task(self.work)
        self.connect("s-1")
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.wait((self._task,))

    def connect(self, session: str) -> None:
        for change in (self.stream.connect(session), *self.state):
            self.stream.feed(change)

    def change(self, keys: np.ndarray) -> None:
        self.stream.feed(MapChanged(keys, 5, 0))

    def reports(self) -> list[dict[str, Any]]:
        return [one for request in self.stream.requests for one in request["changes"]]


def pile(mirror: MapMirror, keys: np.ndarray) -> np.ndarray:
    """Put something of 64 voxels where the map is free."""
    cells = np.full((1, CELLS), -20, np.int8).reshape(8, 8, 8)
    cells[2:6, 2:6, 2:6] = 30
    mirror.put(BlockSet(keys[:1], np.zeros(1, np.uint32), cells.reshape(1, CELLS)), 9)
    return keys[:1]


def free_map() -> tuple[SonarMap, MapMirror, np.ndarray]:
    live = MapMirror(INFO, Interest())
    keys = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    live.put(BlockSet(keys, np.zeros(2, np.uint32), np.full((2, CELLS), -20, np.int8)), 1)
    return map_of(live.cells("known"), 0.25, INFO), live, keys


def test_the_daemon_is_told_what_appears_and_when_it_is_over() -> None:
    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live) as watched:
            watched.change(keys)
            await until(lambda: watched.stream.requests)
            assert watched.stream.requests[0] == {
                "do": "report",
                "changes": [],
                "known": "old.map",
                "begin": True,
            }
            watched.change(pile(live, keys))
            await until(watched.reports)
            (found,) = watched.reports()
            assert (found["kind"], found["voxels"]) == ("appeared", 64)
            assert (found["low_m"], found["high_m"]) == ([0.5] * 3, [1.5] * 3)
            free = np.full((1, CELLS), -20, np.int8)
            live.put(BlockSet(keys[:1], np.zeros(1, np.uint32), free), 10)
            watched.change(keys[:1])
            await until(lambda: len(watched.reports()) == 2)
            assert watched.reports()[1] == {"kind": "over", "id": found["id"]}
            assert sum("64 voxels" in line for line in watched.lines) == 1

    asyncio.run(asyncio.wait_for(run(), 30))


def test_voxels_are_grouped_beside_the_event_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: set[int] = set()

    def noted(*args: Any) -> list[MapChange]:
        threads.add(threading.get_ident())
        return changes_among(*args)

    monkeypatch.setattr("mapperd.bridges.changes.changes_among", noted)

    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live) as watched:
            watched.change(pile(live, keys))
            await until(watched.reports)
            assert [one["voxels"] for one in watched.reports()] == [64]

    asyncio.run(asyncio.wait_for(run(), 30))
    assert threads
    assert threading.get_ident() not in threads


def test_another_session_is_told_everything_again_and_a_refusal_is_one_line() -> None:
    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live) as watched:
            watched.stream.refusal = AskError("needs_token", "a token is needed")
            watched.change(pile(live, keys))
            await until(lambda: any("token" in line for line in watched.lines))
            await asyncio.sleep(1.2)
            assert sum("token" in line for line in watched.lines) == 1
            watched.stream.refusal = None
            await until(lambda: watched.stream.requests[-1]["begin"] and watched.reports())
            del watched.stream.requests[:]
            watched.connect("s-2")
            await until(watched.reports)
            assert watched.stream.requests[0]["begin"]
            assert watched.reports()[0]["voxels"] == 64

    asyncio.run(asyncio.wait_for(run(), 30))


LOCALIZES = a_status(localization={"state": "waiting for a pose"})
WITHDRAWN = {"do": "report", "changes": [], "known": "old.map", "begin": True}


@pytest.mark.parametrize(
    "state",
    [(sure(),), (LOCALIZES,), (sure(state="waiting for a pose", map_odom=None),)],
)
def test_a_map_in_another_frame_is_not_compared(state: tuple[ClientChange, ...]) -> None:
    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live, *state, a_pose(source="odometry")) as watched:
            watched.change(pile(live, keys))
            await until(lambda: any("localization.mapping" in line for line in watched.lines))
            await asyncio.sleep(1.2)
            assert watched.stream.requests == [WITHDRAWN]
            assert sum("localization.mapping" in line for line in watched.lines) == 1

    asyncio.run(asyncio.wait_for(run(), 30))


def test_changes_are_taken_back_once_the_map_is_in_another_frame() -> None:
    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live, LOCALIZES, sure(), a_pose()) as watched:
            watched.change(pile(live, keys))
            await until(watched.reports)
            watched.state = (LOCALIZES, a_pose(source="odometry"))
            watched.connect("s-2")
            await until(lambda: watched.stream.requests[-1] == WITHDRAWN)

    asyncio.run(asyncio.wait_for(run(), 30))


@pytest.mark.parametrize("state", [beat(), LOCALIZES])
def test_nothing_is_compared_before_the_frame_of_the_map_is_known(state: ClientChange) -> None:
    async def run() -> None:
        known, live, keys = free_map()
        async with Watched(known, live, state) as watched:
            watched.change(pile(live, keys))
            await asyncio.sleep(1.2)
            assert watched.stream.requests == []
            watched.stream.feed(LOCALIZES)
            watched.stream.feed(a_pose())
            await until(watched.reports)

    asyncio.run(asyncio.wait_for(run(), 30))


@pytest.mark.parametrize("name", ["none.map", "text.map"])
def test_a_known_map_that_is_none_is_one_line(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "text.map").write_text("no map")
    code = main(["changes", str(tmp_path / name), "--socket", str(tmp_path / "none.sock")])
    assert code in (65, 66)
    assert capsys.readouterr().err.count("\n") == 1


def test_diff_lists_the_changes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known, live, keys = free_map()
    known.save(tmp_path / "a.map")
    pile(live, keys)
    live.to_map().save(tmp_path / "b.map")
    words = ["diff", str(tmp_path / "a.map"), str(tmp_path / "b.map")]
    assert main(words) == 0
    assert "change    appeared, 64 voxels at x 0.50 to 1.50" in capsys.readouterr().out
    assert main([*words, "--min-voxels", "65"]) == 0
    assert "change    " not in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    (change,) = json.loads(capsys.readouterr().out)["changes"]
    assert (change["kind"], change["voxels"], change["low_m"]) == ("appeared", 64, [0.5] * 3)
