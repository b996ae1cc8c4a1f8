"""A map file whose sessions are not in it as a whole is never shown as if they were."""

import json
from pathlib import Path

import pytest

from mapperd.cli.mapperctl import view
from mapperd.config.tree import Config
from mapperd.daemon.map_server import MapServer, saved_map
from mapperd.mapping.sonar_map import SonarMap
from mapperd.store.position import Position
from mapperd.store.tile_store import TileStore
from tests.support.mapperctl import Call
from tests.support.maps import FREE, OCCUPIED, map_of

WHOLE = Position("b", whole=True, sessions=("a", "b"))


def stored(path: Path, position: Position) -> Path:
    sonar_map = map_of(OCCUPIED, FREE)
    tiled = SonarMap(sonar_map.config)
    with TileStore(path, tiled, tile_size_m=10.0, cache_tiles=4) as store:
        bricks = [(key, data) for key, _, data in sonar_map.core.bricks_since(0)[1]]
        tiles = [(x, y, z) for x in (-1, 0) for y in (0, 1, 2) for z in (-1, 0)]
        tiled.core.put_bricks(bricks, tiles)
        store.advance(position.encoded())
    return path


UNFINISHED = Position("b", whole=False, sessions=("a", "b"))
INCOMPLETE = Position("b", whole=True, sessions=("a", "b"), incomplete={"a": "a file is gone"})
UNRECORDED = Position("b", whole=True, sessions=("a", "b"), unrecorded=("b",))
CASES = pytest.mark.parametrize(
    ("position", "named"),
    [
        (UNFINISHED, "session b is incomplete: a daemon maps it now"),
        (INCOMPLETE, "session a is incomplete: a file is gone"),
        (UNRECORDED, "a part of these sessions is in no recording: b"),
    ],
)


@CASES
def test_every_command_names_them_in_a_line(
    tmp_path: Path, call: Call, position: Position, named: str
) -> None:
    path, whole = stored(tmp_path / "a.db", position), stored(tmp_path / "b.db", WHOLE)
    for words in (
        ("convert", path, tmp_path / "out.ply"),
        ("bag", path, tmp_path / "bag"),
        ("diff", path, whole),
    ):
        code, lines, _ = call(*words)
        assert code == 0
        assert [line.startswith(f"{path}: {named}") for line in lines].count(True) == 1
    code, lines, _ = call("convert", whole, tmp_path / "out.ply")
    assert (code, len(lines)) == (0, 2)


def test_json_of_a_comparison_names_them(tmp_path: Path, call: Call) -> None:
    path, whole = stored(tmp_path / "a.db", INCOMPLETE), stored(tmp_path / "b.db", UNRECORDED)
    found = json.loads(call("diff", path, whole, "--json")[1][0])
    assert found["a"]["incomplete"] == {"a": "a file is gone"}
    assert found["a"]["unrecorded"] == []
    assert found["b"]["incomplete"] == {}
    assert found["b"]["unrecorded"] == ["b"]


@CASES
def test_the_page_names_them(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch, position: Position, named: str
) -> None:
    path = stored(tmp_path / "a.db", position)
    problems = MapServer(*saved_map(path, Config()), "a.db", "file").status()["problems"]
    assert [named in problem["text"] for problem in problems] == [True]

    async def end(*_: object) -> None:
        """Do not wait for clients."""

    monkeypatch.setattr(view, "_show", end)
    _, lines, _ = call("view", path, "--port", "0")
    assert lines[1].startswith(f"{path}: {named}")
