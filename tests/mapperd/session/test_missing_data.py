"""Recordings lack a file, an end or a part: the map states it, now and at every later start."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mapperd.config.tree import Config
from mapperd.events import Severity
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.recordings import DamagedData, Tail, files_of, sessions_of
from mapperd.session.recovery import replay_sessions
from mapperd.session.replay_to_store import map_into_store
from mapperd.session_log import DECISIONS, LINK, SESSION, Session, chunk_of
from mapperd.store.metadata import write_checksum
from mapperd.store.position import Position, RecordingOffset, position_in
from oculus_driver.recording import OCULUS, RecordingWriter
from tests.mapperd.conftest import START_NS, make_odometry, make_ping
from tests.mapperd.session.crash import test_startup as sessions
from tests.mapperd.session.test_reconcile import headless, start

S = 1_000_000_000
PARTS = (range(6), range(6, 12), range(12, 18))
HOLE = "file 2 before it cannot be found or read"


def record(
    config: Config, parts: Sequence[range] = PARTS, *, session: str = "a", killed: bool = False
) -> list[Path]:
    """Record a session in several files; a killed one leaves the last of them unclosed."""
    folder = Path(config.recording.folder)
    folder.mkdir(exist_ok=True)
    paths = []
    for number, pings in enumerate(parts, 1):
        path = folder / f"dive_{number:06d}_20231114T221320Z.mcap"
        with RecordingWriter(path, metadata={SESSION: session}) as writer:
            sonar = writer.add_link("sonar", OCULUS)
            vehicle = writer.add_link("vehicle", "odometry-native")
            decisions = writer.add_link(LINK, DECISIONS)
            if number == 1:
                begun = chunk_of(Session(session, "1", msgspec.to_builtins(config)), START_NS)
                writer.write(decisions, begun.data, START_NS)
            for k in pings:
                t_ns = START_NS + k * S // 10
                writer.write(vehicle, make_odometry(p=(0.3 * k, 0.0, 0.0)), t_ns)
                writer.write(sonar, make_ping(k + 1), t_ns + S // 20)
                if k % 2:
                    writer.sync()
            unclosed = path.read_bytes()
        paths.append(path)
    if killed:
        paths[-1].write_bytes(unclosed)
    return paths


def zero(path: Path, size: int) -> None:
    path.write_bytes(bytes(size) + path.read_bytes()[size:])


def flip(path: Path, at: int, mask: int = 1) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= mask
    path.write_bytes(data)


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def spoil_brick(config: Config) -> None:
    with closing(sqlite3.connect(config.outofcore.map_path)) as file, file:
        key = file.execute("SELECT x, y, z FROM brick ORDER BY x DESC LIMIT 1").fetchone()
        file.execute("UPDATE brick SET crc = crc + 1 WHERE x = ? AND y = ? AND z = ?", key)


def named(config: Config, *, lost: bool = True) -> dict[str, str]:
    """Start twice; return the named sessions, which must be the same both times."""
    for _ in range(2):
        events, status = start(config)
        found: dict[str, str] = status["sessions_not_mapped"]
        assert status["data_lost"] is lost
        if found:
            event = events["sessions_not_mapped"]
            assert event.facts["sessions"] == found
            assert (event.severity is Severity.ERROR) is lost
    return found


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_missing_file_in_a_session_is_named(
    tmp_path: Path,
    interrupted: bool,  # noqa: FBT001 a parameter of the test
) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    if interrupted:
        sessions.mapped(config, "a", chunks=8, save_at=5)
    paths[1].unlink()
    assert named(config) == {"a": f"{paths[2].name}: {HOLE}"}


def test_the_first_file_of_an_interrupted_session_is_missing(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    sessions.mapped(config, "a", chunks=3, save_at=0)
    paths[0].unlink()
    assert named(config) == {"a": f"{paths[1].name}: its first file is missing"}


def test_files_before_the_position_of_the_map_may_be_deleted(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    files = files_of(Path(config.recording.folder), "a")
    paths[0].unlink()
    damaged = DamagedData()
    del files[1]
    tail = Tail(files, RecordingOffset(2, 3), damaged)
    assert sum(1 for _ in tail) > 0
    assert tail.loss == ""


@pytest.mark.parametrize("where", [0, 1, 2])
def test_a_file_with_damaged_first_bytes_is_mapped(tmp_path: Path, where: int) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    expected = sessions.reference(config, "a")
    zero(paths[where], 8)
    assert named(config) == {"a": f"{paths[where].name}: the first bytes are damaged"}
    assert sessions.content(config)[0] == expected


@pytest.mark.parametrize("where", [1, 2])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, where: int) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    paths[where].write_bytes(b"not a recording" * 10)
    found = named(config)
    if where == 1:
        assert found == {"a": f"{paths[2].name}: {HOLE}"}
    else:
        assert list(found) == [paths[2].name]


def test_a_session_cut_in_the_middle_is_named(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    cut(paths[1])
    assert list(named(config)) == ["a"]


@pytest.mark.parametrize("what", ["key", "id"])
def test_a_session_with_a_damaged_name_is_mapped_once(tmp_path: Path, what: str) -> None:
    config = sessions.config_of(tmp_path)
    [path] = record(config, [range(8)])
    expected = sessions.reference(config, "a")
    key = path.read_bytes().index(b"session")
    flip(path, key if what == "key" else key + len("session") + 4)
    assert "metadata with a wrong checksum" in named(config)["a"]
    assert sessions.content(config)[0] == expected


def test_a_later_file_with_a_damaged_name_is_a_hole(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    flip(paths[1], paths[1].read_bytes().index(b"session"))
    assert named(config) == {"a": f"{paths[2].name}: {HOLE}"}


def test_a_last_file_with_a_damaged_name_is_named(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    flip(paths[2], paths[2].read_bytes().index(b"session"))
    assert named(config) == {paths[2].name: "its session is not readable"}


def test_files_that_a_power_cut_leaves_empty_are_no_loss(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    record(config, [range(4)])
    folder = Path(config.recording.folder)
    for number, size in ((2, 0), (3, 5), (4, 4096)):
        (folder / f"dive_{number:06d}_20231114T221320Z.mcap").write_bytes(bytes(size))
    assert named(config, lost=False) == {}


@pytest.mark.parametrize(
    ("section", "change", "reason"),
    [
        ("octree", {"voxel_resolution": 0.25}, "octree.voxel_resolution was 0.2"),
        ("outofcore", {"map_path": "/elsewhere.map"}, "another map file"),
    ],
)
def test_sessions_of_other_maps_are_named(
    tmp_path: Path, section: str, change: dict[str, Any], reason: str
) -> None:
    config = sessions.config_of(tmp_path)
    record(config, [range(4)])
    if section == "outofcore":
        change = {"map_path": str(tmp_path / "elsewhere.map")}
    part = msgspec.structs.replace(getattr(config, section), **change)
    assert reason in named(msgspec.structs.replace(config, **{section: part}), lost=False)["a"]


def test_a_session_whose_settings_are_refused_is_named(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    settings = msgspec.to_builtins(config)
    settings["octree"]["voxel_resolution"] = -1
    sessions.record(config, 1, "a", range(4), settings=settings)
    assert "does not accept its settings" in named(config)["a"]


@pytest.mark.parametrize("interrupted", [False, True])
def test_damage_of_a_recording_stays_on_record(
    tmp_path: Path,
    interrupted: bool,  # noqa: FBT001 a parameter of the test
) -> None:
    config = sessions.config_of(tmp_path)
    [path] = record(config, [range(18)])
    if interrupted:
        sessions.mapped(config, "a", chunks=8, save_at=5)
    flip(path, path.stat().st_size // 2)
    assert "fail their checksum and were not mapped" in named(config)["a"]
    assert "a" in sessions.content(config)[1].incomplete


def test_a_recording_that_ends_before_the_map_is_named(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    [path] = record(config, [range(18)])
    sessions.mapped(config, "a", chunks=34, save_at=30)
    cut(path)
    assert "ends before the" in named(config)["a"]


def delete_last(paths: list[Path]) -> None:
    paths[-1].unlink()


def cut_last(paths: list[Path]) -> None:
    cut(paths[-1])


def cut_and_damage_last(paths: list[Path]) -> None:
    cut(paths[-1])
    flip(paths[-1], paths[-1].stat().st_size // 3)


def cut_middle(paths: list[Path]) -> None:
    cut(paths[1])


@pytest.mark.parametrize(
    ("damage", "known_end"),
    [
        (delete_last, True),
        *((cut_last, known) for known in (True, False)),
        *((cut_and_damage_last, known) for known in (True, False)),
        *((cut_middle, known) for known in (True, False)),
    ],
)
def test_bricks_are_whole_only_after_the_whole_recording(
    tmp_path: Path,
    damage: Any,
    known_end: bool,  # noqa: FBT001 a parameter of the test
) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    sessions.mapped(config, "a")
    if not known_end:
        forget_ends(config)
    spoil_brick(config)
    damage(paths)
    for _ in range(2):
        events, _ = start(config)
        assert "bricks_lost" in events
        assert "bricks_rebuilt" not in events


def forget_ends(config: Config) -> None:
    """Write the position as an earlier version does."""
    with closing(sqlite3.connect(config.outofcore.map_path)) as file, file:
        ((data,),) = file.execute("SELECT position FROM progress").fetchall()
        fields = msgspec.msgpack.decode(data)
        assert fields.pop("ends") == {"a": {"file": 3, "chunks": 12}}
        earlier = msgspec.convert({**fields, "crc": None}, Position)
        file.execute("UPDATE progress SET position = ?", (msgspec.msgpack.encode(earlier),))
        write_checksum(file)
    position = position_in(msgspec.msgpack.encode(earlier))
    assert position is not None
    assert position.ends == {}


def test_bricks_of_a_killed_session_are_rebuilt(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    record(config, (*PARTS[:2], range(12, 19)), killed=True)
    assert named(config, lost=False) == {}
    expected = sessions.content(config)
    spoil_brick(config)
    events, _ = start(config)
    assert "bricks_rebuilt" in events
    assert sessions.content(config)[0] == expected[0]
    files = Path(config.recording.folder)
    assert not replay_sessions(SonarMap(config), ("a",), files)
    assert replay_sessions(SonarMap(config), ("a",), files, ends=expected[1].ends)


def test_a_replay_of_a_session_with_a_hole_lists_it(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    paths = record(config)
    damaged = DamagedData()
    sessions_of([paths[0], paths[2]], damaged)
    assert damaged.losses == {paths[2]: HOLE}


def test_a_finished_replay_into_a_store_still_lists_its_loss(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    [path] = record(config, [range(18)])
    flip(path, path.stat().st_size // 2)
    for _ in range(2):
        damaged = DamagedData()
        whole, *_ = map_into_store([path], config, None, tmp_path / "s.map", damaged=damaged)
        whole.close()
        assert damaged.data_lost


def test_a_session_without_its_beginning_is_named(tmp_path: Path) -> None:
    config = sessions.config_of(tmp_path)
    [path] = record(config, [range(8)])
    headless(path)
    assert named(config) == {"a": "its first file is missing"}
