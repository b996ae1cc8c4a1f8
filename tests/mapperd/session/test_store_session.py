"""A map in its file: what is saved stands on what is recorded, and on a checkpoint that it fits."""

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mapperd.config.loader import config_from_text
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.mapping.sonar_map import SonarMap
from mapperd.odometry.records import GeoPoint, Odometry
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.startup import open_map
from mapperd.session.store_session import SqlitePersistence
from mapperd.session_log import Reset
from mapperd.store.position import Position, RecordingOffset, position_in
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore

CONFIG = config_from_text("octree: {voxel_resolution: 0.2}")
WORK = Reset(1)


class Recording:
    """Pieces of which some are written."""

    def __init__(self) -> None:
        self.newest = self.written = 0
        self.timeout_s = 0.0
        self.missing = ""

    def place_of(self, number: int) -> RecordingOffset | None:
        if number == 0:
            return RecordingOffset()
        return RecordingOffset(3, number) if number <= self.written else None

    @property
    def end(self) -> RecordingOffset | None:
        return self.place_of(self.newest)

    def wait_for(self, number: int, timeout_s: float) -> bool:
        self.timeout_s = timeout_s
        return self.written >= number


class Session:
    """A session without a single ping."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.recording = Recording()
        self.woken = threading.Event()
        self.troubles: list[str | None] = []
        sonar_map = SonarMap(CONFIG)
        self.store = TileStore(path, sonar_map, tile_size_m=10, cache_tiles=4)
        counters = PipelineCounters()
        self.engine = SessionDecoder(
            CONFIG, OdometryPoses(CONFIG), counters, confirm=False, obey=True
        )
        self.keep = SqlitePersistence(
            self.store,
            sonar_map,
            "now",
            Position("before", whole=True, sessions=("before",)),
            interval_s=lambda: 0.0 if self.at_once else 3600.0,
            on_trouble=self.troubles.append,
        )
        self.at_once = False
        self.keep.begin(self.engine, self.recording, self.woken.set)

    def position(self) -> Position:
        with StoreReader(self.path) as reader:
            position = position_in(reader.load(SonarMap(CONFIG)).position)
        assert position is not None
        return position


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    session = Session(tmp_path / "dive.map")
    yield session
    session.keep.stop()
    session.store.close()


def checkpoint(session: Session, number: int, waiting: int) -> None:
    session.at_once = True
    session.keep.between(number, waiting)
    session.at_once = False


def test_a_session_is_in_the_file_from_its_beginning(session: Session) -> None:
    position = session.position()
    assert (position.session, position.sessions) == ("now", ("before", "now"))
    assert (position.whole, position.place, position.done) == (False, RecordingOffset(), 0)


def test_the_beginning_of_a_session_does_not_need_the_write_ahead_log(
    session: Session, tmp_path: Path
) -> None:
    without_log = tmp_path / "cut.map"
    without_log.write_bytes(session.path.read_bytes())
    with StoreReader(without_log) as reader:
        position = position_in(reader.load(SonarMap(CONFIG)).position)
    assert position == session.position()
    assert position.sessions == ("before", "now")


def test_nothing_is_saved_that_is_not_recorded(session: Session) -> None:
    session.recording.newest = 7
    session.keep.done(WORK)
    with pytest.raises(StoreError, match="not written") as refused:
        session.store.save()
    assert refused.value.reason == "busy"
    assert session.position().done == 0
    with pytest.raises(StoreError, match="not written"):
        session.store.save()
    assert session.recording.timeout_s == 0.0  # pings do not wait for a disk again and again
    session.recording.written = 7
    session.store.save()
    assert session.position().done == 1


def test_a_checkpoint_counts_once_the_work_before_it_is_done(session: Session) -> None:
    session.recording.newest = session.recording.written = 20
    session.keep.done(WORK)
    session.engine.pings = 5
    checkpoint(session, 12, 2)
    session.keep.done(WORK)
    session.store.save()
    assert (session.position().place, session.position().done) == (RecordingOffset(), 2)
    session.keep.done(WORK)
    session.store.save()
    position = session.position()
    assert (position.place, position.done) == (RecordingOffset(3, 12), 0)
    session.keep.done(WORK)
    session.store.save()
    assert session.position().done == 1


def test_anybody_may_ask_for_a_save(session: Session) -> None:
    session.keep.done(WORK)
    answers: list[Any] = []
    asking = threading.Thread(target=lambda: answers.append(session.keep.save()))
    asking.start()
    assert session.woken.wait(20)
    session.keep.between(0, 0)
    asking.join()
    assert answers == [0]
    assert session.position().done == 1


def test_a_save_does_not_wait_for_ever_for_a_ping(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mapperd.session.store_session.TIMEOUT_S", 0.1)
    with pytest.raises(StoreError, match="a ping is being mapped"):
        session.keep.save()


def test_the_end_leaves_nothing_to_be_done(session: Session) -> None:
    session.keep.done(WORK)
    session.keep.end()
    position = session.position()
    assert position.whole
    assert position.checkpoint == b""
    assert session.troubles == [None, None]


def test_an_empty_map_has_no_sessions_before(session: Session) -> None:
    session.keep.done(WORK)
    session.keep.reset()
    session.store.save()
    assert session.position().sessions == ("now",)


def test_the_next_session_has_the_zero_of_this_one(tmp_path: Path) -> None:
    session = Session(tmp_path / "dive.map")
    here = GeoPoint(math.radians(54.0), math.radians(10.5), None)
    record = Odometry(0, "arrival", geo=here, source="vehicle")
    assert isinstance(session.engine.poses, OdometryPoses)
    taken = session.engine.poses.odometry.fusion.take("vehicle", record, 1_000)
    assert taken is None
    session.keep.end()
    session.keep.stop()
    assert session.position().origin_deg == pytest.approx((54.0, 10.5))
    session.store.close()
    opened = open_map(
        config_from_text(
            "octree: {voxel_resolution: 0.2}\n"
            f"outofcore: {{use: true, map_path: {tmp_path / 'dive.map'}}}\n"
            f"recording: {{folder: {tmp_path / 'recordings'}}}"
        ),
        "next",
        events := EventLog(time.time_ns),
        {},
        lambda: 3600.0,
    )
    opened.close()
    assert opened.origin_deg == pytest.approx((54.0, 10.5))
    (event,) = events.since(0)[0]
    assert event.code == "map_continued"
    assert "mapperctl reset" in event.text
