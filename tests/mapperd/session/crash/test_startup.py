"""What the daemon finds at its start: a session cut short, damage, another map, a full disk."""

import itertools
import sqlite3
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.mapping.arc import SurfaceLevel, SurfaceLevelState
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.pose_lookup import OdometryPoses
from mapperd.session.recordings import Tail, files_of
from mapperd.session.recovery import StoredSession, map_rest, replay_sessions
from mapperd.session.startup import open_map
from mapperd.session_log import (
    DECISIONS,
    LINK,
    SESSION,
    Drop,
    RemovedRemark,
    Reset,
    Session,
    Settings,
    chunk_of,
    remarks_in,
)
from mapperd.store.checkpoint import decode_state
from mapperd.store.metadata import write_checksum
from mapperd.store.position import Position, RecordingOffset, position_in
from mapperd.store.reader import StoreReader
from mapperd.store.tile_store import TileStore
from oculus_driver.recording import OCULUS, RecordingWriter
from tests.mapperd.conftest import BEAMS, ROWS, START_NS, WALL_ROW, make_odometry, make_ping

pytestmark = pytest.mark.crash

S = 1_000_000_000

RULES = pytest.mark.parametrize("rule", ["", "mapping: {rule: arc}\n"], ids=["iwlo", "arc"])


def config_of(folder: Path, more: str = "") -> Config:
    return config_from_text(
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
        f"outofcore: {{use: true, map_path: {folder}/dive.map, tile_size: 6.4, cache_size: 2}}\n"
        f"recording: {{folder: {folder}/recordings, free_floor: 0}}\n{more}"
    )


def wall_of(config: Config, ping: int) -> NDArray[np.uint8]:
    """A wall 3 m away; for the arc rule its level changes from ping to ping."""
    image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
    image[WALL_ROW : WALL_ROW + 2] = 200 if config.mapping.rule == "iwlo" else 20 + 3 * (ping % 10)
    return image


def record(config: Config, number: int, session: str, pings: range, **decided: Any) -> Path:
    """A recorded session: odometry, pings, what was decided before ping `at`, and `settings`."""
    folder = Path(config.recording.folder)
    folder.mkdir(exist_ok=True)
    path = folder / f"dive_{number:06d}_20231114T221320Z.mcap"
    with RecordingWriter(path, metadata={SESSION: session}) as writer:
        links = {
            "sonar": writer.add_link("sonar", OCULUS),
            "vehicle": writer.add_link("vehicle", "odometry-native"),
            LINK: writer.add_link(LINK, DECISIONS),
        }

        def log(decision: Any, t_ns: int) -> None:
            writer.write(links[LINK], chunk_of(decision, t_ns).data, t_ns)

        settings = decided.get("settings", msgspec.to_builtins(config))
        log(Session(session, "1", settings), START_NS)
        for k in pings:
            t_ns = START_NS + k * S // 10
            if k == decided.get("at"):
                log(decided["what"], t_ns)
            odometry = make_odometry(p=(0.3 * k, 0.0, 0.0))
            writer.write(links["vehicle"], odometry, t_ns)
            data = make_ping(k + 1, image=wall_of(config, k))
            writer.write(links["sonar"], data[:1000], t_ns + S // 20)
            writer.write(links["sonar"], data[1000:], t_ns + S // 20 + 1000)
    return path


def reference(config: Config, *sessions: str) -> str:
    sonar_map = SonarMap(config)
    assert replay_sessions(sonar_map, sessions, Path(config.recording.folder))
    return sonar_map.sha256()


def mapped(config: Config, session: str, *, chunks: int | None = None, save_at: int = 0) -> None:
    """Map a session into the file, and die after so many chunks, the last save long before."""
    sonar_map = SonarMap(config)
    settings = config.outofcore
    store = TileStore(
        Path(settings.map_path),
        sonar_map,
        tile_size_m=settings.tile_size,
        cache_tiles=settings.cache_size,
    )
    position = position_in(store.position)
    files = files_of(Path(config.recording.folder), session)
    stored = StoredSession(store, sonar_map, session, None, position, 3600.0)
    remarks = remarks_in(Tail(files, RecordingOffset()))
    steps = map_rest(stored, OdometryPoses(config), Tail(files, RecordingOffset()), remarks)
    for count, _ in enumerate(steps):
        if count == save_at:
            store.save()
        if count == chunks:
            break
    steps.close()
    store.close()


def opened(config: Config) -> EventLog:
    events = EventLog(lambda: 0)
    open_map(config, "new", events, {}, lambda: 1.0).close()
    return events


def codes(events: EventLog) -> list[str]:
    codes = [event.code for event in events.since(0)[0]]
    return [
        code for code in codes if code != "map_continued"
    ]  # which every start but the first reports


def content(config: Config) -> tuple[str, Position]:
    sonar_map = SonarMap(config)
    with StoreReader(Path(config.outofcore.map_path)) as reader:
        loaded = reader.load(sonar_map)
    position = position_in(loaded.position)
    assert position is not None
    return sonar_map.sha256(), position


@RULES
@pytest.mark.parametrize("save_at", [0, 20, 55])
@pytest.mark.parametrize(
    "what",
    [
        None,
        Reset(1, "test"),
        Drop(10),
        Settings({"filtering.intensity_threshold": 190}),
        Settings({"processing.frame_skip": 2}),
    ],
)
def test_the_rest_of_a_session_is_mapped_with_what_was_decided(
    tmp_path: Path, save_at: int, what: Any, rule: str
) -> None:
    config = config_of(tmp_path, rule)
    record(config, 1, "a", range(30), at=12, what=what)
    mapped(config, "a", chunks=60, save_at=save_at)
    assert not content(config)[1].whole
    events = opened(config)
    assert codes(events) == ["recovered"]
    found, position = content(config)
    assert position.whole
    assert found == reference(config, "a")
    assert codes(opened(config)) == []  # nothing is missing any more


def aged(value: Any) -> Any:
    """Plain values of a store or a recording as an earlier version wrote them."""
    if isinstance(value, list):
        return [aged(one) for one in value]
    if not isinstance(value, dict):
        return value
    found = {key: aged(one) for key, one in value.items()}
    if "mapping" in found and "behind" in found:
        found["mapping"] |= {"integrator": "projective", "error_bound": 0.1}
        found["behind"] |= {"policy": "coarser_first", "error_bound": 0.5}
        found["mapping"].pop("detail")
    return found


@pytest.mark.parametrize(
    "what",
    [
        RemovedRemark(),
        Settings({"mapping.error_bound": 0.5, "mapping.integrator": "projective"}),
        Settings({"mapping.error_bound": 0.5, "filtering.intensity_threshold": 190}),
    ],
)
def test_a_session_of_an_earlier_version_goes_on(tmp_path: Path, what: Any) -> None:
    config = config_of(tmp_path)
    settings = aged(msgspec.to_builtins(config))
    record(config, 1, "a", range(30), at=12, what=what, settings=settings)
    mapped(config, "a", chunks=60, save_at=20)
    with closing(sqlite3.connect(tmp_path / "dive.map")) as file, file:
        ((data,),) = file.execute("SELECT position FROM progress").fetchall()
        position = aged(msgspec.msgpack.decode(data)) | {"error_bound": 0.5}
        file.execute("UPDATE progress SET position = ?", (msgspec.msgpack.encode(position),))
        write_checksum(file)
    assert not content(config)[1].whole
    assert codes(opened(config)) == ["recovered"]
    assert content(config)[0] == reference(config, "a")


@RULES
def test_sessions_follow_each_other_in_one_map(tmp_path: Path, rule: str) -> None:
    config = config_of(tmp_path, rule)
    record(config, 1, "a", range(10))
    record(config, 2, "b", range(20, 40))
    mapped(config, "a")
    mapped(config, "b", chunks=30)
    opened(config)
    found, position = content(config)
    assert found == reference(config, "a", "b")
    assert position.sessions == ("a", "b")


def spoil(path: Path, *, rows: int) -> None:
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(
            "UPDATE brick SET data = x'00' WHERE rowid IN (SELECT rowid FROM brick LIMIT ?)",
            (rows,),
        )


@RULES
def test_damaged_bricks_are_rebuilt_from_all_sessions(tmp_path: Path, rule: str) -> None:
    config = config_of(tmp_path, rule)
    record(config, 1, "a", range(25))
    record(config, 2, "b", range(15, 40))
    mapped(config, "a")
    mapped(config, "b", chunks=60, save_at=40)
    spoil(tmp_path / "dive.map", rows=2)
    assert codes(opened(config)) == ["recovered", "bricks_rebuilt"]
    assert content(config)[0] == reference(config, "a", "b")


def test_bricks_whose_recordings_are_gone_stay_on_record(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    record(config, 1, "a", range(10))
    record(config, 2, "b", range(20))
    mapped(config, "a")
    mapped(config, "b", chunks=30)
    for path in files_of(Path(config.recording.folder), "a").values():
        path.unlink()
    spoil(tmp_path / "dive.map", rows=2)
    assert codes(opened(config)) == ["recovered", "bricks_lost"]


def test_recordings_that_are_gone_are_reported_to_be(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    path = record(config, 1, "a", range(30))
    mapped(config, "a", chunks=60)
    path.unlink()
    assert codes(opened(config)) == ["not_recovered"]


def test_mapping_again_that_is_cut_short_is_begun_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path)
    for number, session in enumerate("ab"):
        record(config, number + 1, session, range(20 * number, 20 * number + 20))
        mapped(config, session)
    path = Path(config.outofcore.map_path)
    data = path.read_bytes()
    path.write_bytes(data[:100] + b"x" * 4000 + data[4100:])

    def killed(stored: StoredSession, *rest: Any, **more: Any) -> Any:
        for count, _ in enumerate(map_rest(stored, *rest, **more)):
            if count == 10:
                stored.store.save()
            if count == 15:
                raise KeyboardInterrupt
            yield

    with monkeypatch.context() as patch:
        patch.setattr("mapperd.session.recovery.map_rest", killed)
        with pytest.raises(KeyboardInterrupt):
            opened(config)
    assert codes(opened(config)) == ["store_damaged", "map_rebuilt"]
    assert content(config)[0] == reference(config, "a", "b")
    assert codes(opened(config)) == []


def test_a_file_that_is_no_map_any_more_is_put_aside_and_mapped_again(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    record(config, 1, "a", range(10))
    record(config, 2, "b", range(20))
    mapped(config, "a")
    mapped(config, "b")
    path = tmp_path / "dive.map"
    data = bytearray(path.read_bytes())
    data[100:4000] = bytes(3900)
    path.write_bytes(data)
    assert codes(opened(config)) == ["store_damaged", "map_rebuilt"]
    assert path.with_name("dive.map.damaged-1").exists()
    assert content(config)[0] == reference(config, "a", "b")


def test_a_map_of_other_settings_is_refused_and_untouched(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    record(config, 1, "a", range(10))
    mapped(config, "a")
    before = content(config)
    for other, stated in (
        ("iwlo: {L_occ: 1.5}\n", r"iwlo\.L_occ is"),
        ("mapping: {rule: arc}\n", 'mapping.rule is "iwlo" in it, "arc" in the settings'),
    ):
        with pytest.raises(StoreError, match=stated) as refused:
            opened(config_of(tmp_path, other))
        assert refused.value.reason == "other_parameters"
    assert content(config) == before


def test_a_session_of_another_rule_is_not_mapped_into_the_file(tmp_path: Path) -> None:
    arc = config_of(tmp_path, "mapping: {rule: arc}\n")
    record(arc, 1, "a", range(10))
    mapped(arc, "a")
    record(config_of(tmp_path), 2, "b", range(10))
    assert codes(opened(arc)) == ["sessions_not_mapped"]
    assert content(arc)[0] == reference(arc, "a")


def take_checkpoints_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a second pass with each look at the clock."""
    seconds = itertools.count(0.0)
    clock = SimpleNamespace(monotonic=lambda: next(seconds))
    monkeypatch.setattr("mapperd.session.store_session.time", clock)


def spoil_checkpoint(config: Config, folder: Path) -> None:
    """Replace the checkpoint by one of an earlier format."""
    _, position = content(config)
    assert position.place > RecordingOffset()
    earlier = msgspec.msgpack.encode([1, [["o", "mapperd.engine:Engine", []]]])
    bad = msgspec.structs.replace(position, checkpoint=earlier)
    with closing(sqlite3.connect(folder / "dive.map")) as file, file:
        file.execute("UPDATE progress SET position = ?", (bad.encoded(),))
        write_checksum(file)


@RULES
@pytest.mark.parametrize("what", [None, Reset(1, "test"), Settings({"filtering.min_range": 1.5})])
def test_with_a_checkpoint_of_an_earlier_format_the_recording_is_read_from_its_start(
    tmp_path: Path, what: Any, rule: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path, rule)
    record(config, 1, "a", range(30), **({} if what is None else {"at": 12, "what": what}))
    take_checkpoints_often(monkeypatch)
    mapped(config, "a", chunks=60, save_at=40)
    spoil_checkpoint(config, tmp_path)
    events = opened(config)
    assert codes(events) == ["recovered"]
    (text,) = [event.text for event in events.since(0)[0] if event.code == "recovered"]
    assert "recording's start" in text
    assert "format 1" in text
    assert content(config)[0] == reference(config, "a")


def test_the_level_of_surfaces_goes_on_from_the_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path, "mapping: {rule: arc}\n")
    record(config, 1, "a", range(40))
    take_checkpoints_often(monkeypatch)
    for chunks, save_at in ((100, 60), (100, 99)):
        mapped(config, "a", chunks=chunks, save_at=save_at)
        position = content(config)[1]
        assert position.place > RecordingOffset()
        surface = SurfaceLevel(config.octree.voxel_resolution)
        surface.restore(decode_state(position.surface, SurfaceLevelState))
        assert surface.returns > 0
        assert codes(opened(config)) == ["recovered"]
        assert content(config)[0] == reference(config, "a")
        (tmp_path / "dive.map").unlink()


def test_without_the_recordings_start_an_earlier_checkpoint_leaves_the_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_of(tmp_path)
    path = record(config, 1, "a", range(30))
    take_checkpoints_often(monkeypatch)
    mapped(config, "a", chunks=60, save_at=40)
    spoil_checkpoint(config, tmp_path)
    found, _ = content(config)
    path.unlink()
    assert codes(opened(config)) == ["not_recovered"]
    assert content(config)[0] == found
