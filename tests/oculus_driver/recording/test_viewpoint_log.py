"""ViewPoint logs: SQLite files, sound, odd and hostile."""

from __future__ import annotations

import sqlite3
import struct
import zlib
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oculus_driver.recording import VIEWPOINT_LOG, describe, open_recording

if TYPE_CHECKING:
    from pathlib import Path

    from oculus_driver.recording import Chunk, Recording
    from tests.oculus_driver.conftest import MakePing

TABLES = """
CREATE TABLE metadata (key TEXT, value TEXT);
CREATE TABLE dataSources (dataSourceId INTEGER, dataSourceType INTEGER, dataSourceName TEXT);
CREATE TABLE data (entryId INTEGER PRIMARY KEY, timestamp INTEGER, type INTEGER,
                   dataSourceId INTEGER, length INTEGER, payload BLOB);
INSERT INTO metadata VALUES ('logVersion', '2'), ('applicationName', 'ViewPoint');
INSERT INTO dataSources VALUES (1, 0, 'M750d'), (2, 1, 'SeaTrac'), (3, 0, 'M1200d');
"""
START_MS = 1_700_000_000_123

Entry = tuple[Any, int, bytes]


def write(path: Path, entries: list[Entry], tables: str = TABLES) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(tables)
        rows = [(time, source, len(data), data) for time, source, data in entries]
        connection.executemany(
            "INSERT INTO data (timestamp, type, dataSourceId, length, payload)"
            " VALUES (?, 1, ?, ?, ?)",
            rows,
        )
        connection.commit()


def read(path: Path) -> tuple[list[Chunk], Recording]:
    with open_recording(path) as recording:
        assert recording.format == VIEWPOINT_LOG
        return list(recording), recording


def test_the_messages_of_a_log_come_with_their_stamps(tmp_path: Path, capture: bytes) -> None:
    path = tmp_path / "dive #1?.oculus"
    pings = [capture[at : at + 182016] for at in (0, 182016, 364032)]
    write(path, [(START_MS + 100 * i, 1, ping) for i, ping in enumerate(pings)])
    chunks, recording = read(path)
    assert [chunk.data for chunk in chunks] == pings
    assert [chunk.arrival_ns for chunk in chunks] == [
        START_MS * 10**6 + 10**8 * i for i in range(3)
    ]
    assert {chunk.link for chunk in chunks} == {"sonar"}
    assert recording.metadata == {"logVersion": "2", "applicationName": "ViewPoint"}
    assert (recording.damage, recording.start_ns) == (None, START_MS * 10**6)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [path.name]
    with open_recording(path) as again:
        assert [again.bytes_read for _ in again] == [182016, 364032, 546048]
        assert again.bytes_read == again.size_bytes > 546048


def test_sources_are_kept_apart_and_others_left_out(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "log"
    ping = make_ping()
    write(path, [(1, 3, ping), (2, 2, b"$SEATRAC"), (3, 1, ping), (4, 3, ping)])
    chunks, recording = read(path)
    assert [chunk.link for chunk in chunks] == ["sonar", "sonar-2", "sonar"]
    assert recording.damage is None


def test_compressed_payloads_are_unpacked(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "log"
    ping = make_ping()
    packed = zlib.compress(ping)
    bomb = zlib.compress(bytes(17 << 20), 1)
    entries = [packed, struct.pack(">I", len(ping)) + packed, b"junk", bomb, ping]
    write(path, [(START_MS, 1, entry) for entry in entries])
    chunks, recording = read(path)
    assert [chunk.data for chunk in chunks] == [ping] * 3
    assert [chunk.gap_before for chunk in chunks] == [False, False, True]
    assert recording.faults == 2


def test_values_of_any_type_are_taken_as_they_are(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "log"
    times = ["yesterday", None, float("inf"), -5, 1 << 62, 12.5]
    write(path, [(time, 1, make_ping()) for time in times])
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("INSERT INTO data (payload) VALUES (NULL), (7), ('SO text')")
        connection.commit()
    chunks, recording = read(path)
    assert [chunk.arrival_ns for chunk in chunks] == [None] * 5 + [12_500_000, None]
    assert recording.faults == 2


@pytest.mark.parametrize(
    "tables",
    [
        "CREATE TABLE other (x);",
        "CREATE TABLE data (entryId, payload);",
        (
            "CREATE VIEW data AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
            " SELECT i AS rowid, i AS timestamp, i AS dataSourceId, i AS payload FROM n;"
        ),
    ],
)
def test_other_databases_hold_nothing(tmp_path: Path, tables: str) -> None:
    path = tmp_path / "log"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(tables)
    chunks, recording = read(path)
    assert chunks == []
    assert recording.damage is not None


def test_a_table_that_is_code_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE VIRTUAL TABLE data USING fts5(timestamp, dataSourceId, payload)")
        connection.execute("INSERT INTO data VALUES (5, 0, 'SO, a text')")
        connection.commit()
    chunks, recording = read(path)
    assert chunks == []
    assert "no table named data" in (recording.damage or "")


def test_a_log_that_was_not_closed_is_read_with_its_write_ahead_log(
    tmp_path: Path, make_ping: MakePing
) -> None:
    path = tmp_path / "log"
    write(path, [])
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("INSERT INTO data VALUES (1, 5, 1, 1, 0, ?)", (make_ping(),))
        connection.commit()
        chunks, _ = read(path)
    assert [chunk.data for chunk in chunks] == [make_ping()]


def test_damaged_databases_give_what_they_can(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "log"
    write(path, [(START_MS, 1, make_ping(ping_id=index)) for index in range(30)])
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    for size in (16, 100, 3000, len(whole) // 2):
        path.write_bytes(whole[:size])
        _, recording = read(path)
        assert recording.truncated
    for _ in range(60):
        hurt = bytearray(whole)
        for at in rng.integers(16, len(hurt), 40):
            hurt[at] = rng.integers(256)
        path.write_bytes(hurt)
        with open_recording(path) as recording:
            assert describe(recording).pings <= 30


def test_a_file_that_is_not_there_any_more_is_no_damage_of_it(
    tmp_path: Path, make_ping: MakePing
) -> None:
    path = tmp_path / "log"
    write(path, [(1, 1, make_ping())])
    with open_recording(path) as recording:
        away = path.rename(tmp_path / "away")
        assert list(recording) == []
        assert str(path) in str(recording.read_error)
        away.rename(path)
        assert len(list(recording)) == 1
        assert (recording.read_error, recording.damage) == (None, None)


@pytest.mark.parametrize(
    ("code", "refused"),
    [
        (sqlite3.SQLITE_IOERR_READ, True),
        (sqlite3.SQLITE_BUSY, True),
        (sqlite3.SQLITE_CANTOPEN, True),
        (sqlite3.SQLITE_IOERR_SHORT_READ, False),
        (sqlite3.SQLITE_CORRUPT, False),
        (sqlite3.SQLITE_ERROR, False),
    ],
)
def test_what_a_disk_refuses_is_no_damage(
    tmp_path: Path,
    make_ping: MakePing,
    monkeypatch: pytest.MonkeyPatch,
    code: int,
    refused: bool,  # noqa: FBT001 two ways
) -> None:
    path = tmp_path / "log"
    write(path, [(1, 1, make_ping())])

    def fails(*_: object) -> None:
        error = sqlite3.OperationalError("no")
        error.sqlite_errorcode = code
        raise error

    monkeypatch.setattr("oculus_driver.recording.viewpoint_log._sources", fails)
    chunks, recording = read(path)
    assert chunks == []
    assert recording.truncated
    assert (recording.read_error is not None) == refused


def test_a_schema_that_is_no_text_is_damage(tmp_path: Path, make_ping: MakePing) -> None:
    path = tmp_path / "log"
    write(path, [(1, 1, make_ping())])
    data = path.read_bytes()
    name, made = b"tabledatadata", b"CREATE TABLE data "
    assert data.count(name) == data.count(made) == 1
    damaged = data.replace(name, b"tabled\x8ftadata").replace(made, b"CREATE TXBLE data ")
    path.write_bytes(damaged)
    chunks, recording = read(path)
    assert chunks == []
    assert recording.truncated
    assert recording.read_error is None
