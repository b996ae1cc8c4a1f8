"""The disk is full at the end of a session: what fits is kept, and the rest is named."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from mapperd.config.tree import RecordingConfig
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.pipeline.decoder import SessionDecoder
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.pipeline.recorder import Recorder
from mapperd.session.startup import open_map
from mapperd.session.store_session import SqlitePersistence
from mapperd.session_log import Reset
from mapperd.store.position import Position, position_in
from mapperd.store.reader import Loaded, StoreReader
from mapperd.store.tile_store import TileStore
from tests.mapperd.session.test_store_session import Recording
from tests.mapperd.store import dive
from tests.mapperd.store.test_full_disk import fill_disk, free_disk

PINGS = 30


class Dive:
    """A session of pings whose recording is written, or is not."""

    def __init__(self, path: Path) -> None:
        self.recording = Recording()
        self.losses: list[str] = []
        sonar_map = SonarMap(dive.CONFIG)
        self.map = sonar_map
        self.store = TileStore(path, sonar_map, tile_size_m=6.4, cache_tiles=100)
        self.keep = SqlitePersistence(
            self.store,
            sonar_map,
            "now",
            interval_s=lambda: 3600.0,
            on_loss=self.losses.append,
        )

    def begin(self) -> None:
        poses = OdometryPoses(dive.CONFIG)
        decoder = SessionDecoder(dive.CONFIG, poses, PipelineCounters(), confirm=False, obey=True)
        self.keep.begin(decoder, self.recording, lambda: None)

    def ping(self, number: int) -> None:
        dive.integrate(self.map, number)
        self.recording.newest += 1
        self.keep.done(Reset(1))  # counts like any work

    def content(self) -> tuple[SonarMap, Loaded, Position]:
        whole = SonarMap(dive.CONFIG)
        with StoreReader(self.store.path) as reader:
            loaded = reader.load(whole)
        position = position_in(loaded.position)
        assert position is not None
        return whole, loaded, position


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Dive]:
    monkeypatch.setattr("mapperd.session.store_session.TIMEOUT_S", 0.05)
    session = Dive(tmp_path / "dive.map")
    session.begin()
    for number in range(PINGS):
        session.ping(number)
    yield session
    session.keep.stop()
    session.store.close()


def test_a_map_whose_recording_is_paused_is_saved_at_the_end(session: Dive) -> None:
    session.keep.end()
    whole, loaded, position = session.content()
    assert whole.sha256() == dive.mapped(PINGS).sha256()
    assert not loaded.lost
    assert position.whole
    assert position.unrecorded == ("now",)  # a rebuild from the recordings is not the whole map
    assert session.losses == []
    assert session.keep.whole().sha256() == whole.sha256()


def test_a_full_disk_at_the_end_leaves_the_rest_to_the_recording(session: Dive) -> None:
    session.recording.written = session.recording.newest
    fill_disk(session.store)
    session.keep.end()
    assert not session.content()[2].whole
    (loss,) = session.losses
    assert "the next start maps the rest from the recording" in loss
    whole = session.keep.whole()  # the results are of the whole map all the same
    lost = whole.bricks_lost
    assert (whole.sha256(), lost) == (dive.mapped(PINGS).sha256(), 0)


@pytest.mark.parametrize("pages", [4, 20])
def test_what_fits_is_saved_and_the_rest_is_named(session: Dive, pages: int) -> None:
    connection = session.store._saver._connection
    (used,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {used + pages}")
    session.keep.end()
    (loss,) = session.losses
    assert "bricks are not in the file" in loss
    in_file, loaded, position = session.content()
    reference = dive.mapped(PINGS)
    assert position.whole
    assert list(position.incomplete) == ["now"]
    bricks = {key for key, _, _ in reference.core.bricks_since(0)[1]}
    saved = {key: brick for key, _, brick in in_file.core.bricks_since(0)[1]}
    assert loaded.lost == bricks - saved.keys()
    assert 0 < len(saved) < len(bricks)
    whole = session.keep.whole()
    lost = whole.bricks_lost
    assert (whole.sha256(), lost) == (reference.sha256(), 0)


def test_what_was_not_saved_is_named_at_the_next_start(session: Dive, tmp_path: Path) -> None:
    connection = session.store._saver._connection
    (used,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {used + 20}")
    session.keep.end()
    session.store.close()
    settings = {
        "outofcore": msgspec.structs.replace(
            dive.CONFIG.outofcore, use=True, map_path=str(session.store.path)
        ),
        "recording": RecordingConfig(folder=str(tmp_path / "recordings"), free_floor=0),
    }
    events = EventLog(lambda: 0)
    opened = open_map(
        msgspec.structs.replace(dive.CONFIG, **settings), "next", events, {}, lambda: 1.0
    )
    opened.close()
    found = {event.code: event for event in events.since(0)[0]}
    assert found["bricks_lost"].facts["bricks"] > 0
    assert list(found["sessions_not_mapped"].facts["sessions"]) == ["now"]


def test_nothing_is_left_out_when_there_is_space_again(session: Dive) -> None:
    fill_disk(session.store)
    session.recording.missing = "it is not recorded"
    with pytest.raises(StoreError):
        session.store.save()
    free_disk(session.store)
    session.keep.end()
    assert session.content()[0].sha256() == dive.mapped(PINGS).sha256()
    assert session.losses == []


def refuse_all(store: TileStore) -> None:
    """Let the disk be so full that not even the position can be written."""
    store._saver._connection.execute(
        "CREATE TRIGGER full BEFORE UPDATE ON progress BEGIN "
        "INSERT INTO quarantine (x, y, z, data, reason) "
        "VALUES (0, 0, 0, zeroblob(10000000), ''); END"
    )
    fill_disk(store)


def test_results_have_the_whole_map_though_nothing_could_be_saved(session: Dive) -> None:
    refuse_all(session.store)
    session.keep.end()
    (loss,) = session.losses
    assert "nothing since the last save is in the file, nor in a recording" in loss
    assert not session.content()[2].whole
    whole = session.keep.whole()
    lost = whole.bricks_lost
    assert (whole.sha256(), lost) == (dive.mapped(PINGS).sha256(), 0)


def test_a_session_whose_beginning_cannot_be_saved_is_refused(tmp_path: Path) -> None:
    session = Dive(tmp_path / "dive.map")
    refuse_all(session.store)
    with pytest.raises(StoreError) as refused:
        session.begin()
    assert refused.value.reason == "disk_full"
    session.store.close()


def test_a_recorder_states_that_it_could_record_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free_mib = shutil.disk_usage(tmp_path).free >> 20
    monkeypatch.setenv("LOGS_DIRECTORY", str(tmp_path))
    config = dive.CONFIG

    def recorder(floor_mib: int, *, enabled: bool = True) -> Recorder:
        recording = RecordingConfig(enabled=enabled, free_floor=floor_mib)
        return Recorder(msgspec.structs.replace(config, recording=recording), "now")

    assert recorder(0).shortage() is None
    problem = recorder(free_mib + 10_000).shortage()
    assert problem is not None
    assert "free_space" in problem
    assert f"recording.free_floor is {free_mib + 10_000} MiB" in problem
    assert recorder(free_mib + 10_000, enabled=False).shortage() is None
