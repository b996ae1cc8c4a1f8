"""`mapperctl export`: the map of a daemon that is watched becomes a file."""

import asyncio
import json
import re
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import laspy
import numpy as np
import pytest
from msgspec.structs import replace
from plyfile import PlyData

from mapperd.cli.mapperctl.arguments import parser
from mapperd.cli.mapperctl.command import main
from mapperd.cli.mapperctl.export import _ExportProgress
from mapperd.client import Interest, MapBox, MapMirror
from mapperd.config.tree import Config
from mapperd.export.formats import FORMATS
from mapperd.mapping.sonar_map import SonarMap
from mapperd.wire.blocks import CELLS, BlockSet, encode_blocks
from mapperd.wire.messages import MAX_LEVEL, BlocksMessage, ByeMessage
from tests.mapperd.foxglove.test_recording import read
from tests.support.stream_server import MAP_INFO, Connection, Served, Server, a_block

pytestmark = pytest.mark.net


Call = Callable[..., tuple[int, list[str], str]]


class Watched:
    """A map that is served in a thread of its own."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.served = Served()
        for key in ((0, 0, 0), (-1, 2, -3), (5, -4, 0)):
            self.served.put(key, a_block(key[0] + 40))
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self._thread.start()
        assert self._ready.wait(60)

    async def _run(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        async with Server(self.served, self.path):
            self._ready.set()
            await self._end.wait()

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(60)

    def mirror(self) -> MapMirror:
        """What there is to be exported."""
        mirror = MapMirror(self.served.info, Interest())
        mirror.put(self.served.since(0), 10**18)
        return mirror


@pytest.fixture
def watched(short: Path) -> Iterator[Watched]:
    server = Watched(short / "map.sock")
    yield server
    server.stop()


@pytest.fixture
def export(
    watched: Watched, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Call:
    monkeypatch.setattr("mapperd.cli.mapperctl.export.LOG_PERIOD_S", 1e9)

    def run(*words: str | Path) -> tuple[int, list[str], str]:
        code = main(["export", *map(str, words), "--socket", str(watched.path)])
        output = capsys.readouterr()
        assert output.err.count("\n") == (code != 0)
        return code, output.out.splitlines(), output.err

    return run


def cells_of(mirror: MapMirror, min_probability: float | None = None) -> list[tuple[float, ...]]:
    centres_m = mirror.cells("occupied", min_probability=min_probability).centres_m
    return sorted(tuple(row) for row in centres_m.round(4).tolist())


def centres_in(path: Path) -> list[tuple[float, ...]]:
    return sorted(tuple(row) for row in np.loadtxt(path, ndmin=2).tolist())


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_is_exported(
    tmp_path: Path, export: Call, watched: Watched, suffix: str
) -> None:
    path = tmp_path / f"live{suffix}"
    code, lines, _ = export(path)
    assert code == 0
    assert lines[0] == f"{path}: {path.stat().st_size} bytes"
    assert watched.served.hellos[0].wants == ["map"]
    assert sorted(tmp_path.iterdir()) == sorted({path, *tmp_path.glob("live.yaml")})


def test_all_occupied_cells_are_in_the_file(tmp_path: Path, export: Call, watched: Watched) -> None:
    export(tmp_path / "live.xyz")
    expected = cells_of(watched.mirror())
    assert len(expected) > 500
    assert centres_in(tmp_path / "live.xyz") == expected


def test_file_of_the_whole_map_is_that_of_its_mirror(
    tmp_path: Path, export: Call, watched: Watched
) -> None:
    export(tmp_path / "live.map")
    watched.mirror().to_map().save(tmp_path / "mirror.map")
    assert (tmp_path / "live.map").read_bytes() == (tmp_path / "mirror.map").read_bytes()


@pytest.mark.parametrize("min_probability", [0.3, 0.9])
def test_probability_decides_what_is_occupied(
    tmp_path: Path, export: Call, watched: Watched, min_probability: float
) -> None:
    assert export(tmp_path / "live.xyz", "--min-probability", str(min_probability))[0] == 0
    assert centres_in(tmp_path / "live.xyz") == cells_of(watched.mirror(), min_probability)


def test_probabilities_are_calibrated(tmp_path: Path, export: Call) -> None:
    curve = tmp_path / "curve.yaml"
    curve.write_text("log_odds: [0.0]\ncalibrated: [0.0]\n")
    assert export(tmp_path / "live.ply", "--calibration", curve)[0] == 0
    reported = PlyData.read(str(tmp_path / "live.ply"))["vertex"]["probability"]
    assert len(reported) > 500
    assert (reported == 0.5).all()
    assert export(tmp_path / "live.mcap", "--calibration", curve)[0] == 73


def test_a_curve_that_goes_while_the_map_comes_was_read_before(
    tmp_path: Path, export: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    curve = tmp_path / "curve.yaml"
    curve.write_text("log_odds: [0.0]\ncalibrated: [0.0]\n")
    to_map = MapMirror.to_map

    def lose(mirror: MapMirror, config: Config | None = None) -> SonarMap:
        curve.unlink()
        return to_map(mirror, config)

    monkeypatch.setattr(MapMirror, "to_map", lose)
    assert export(tmp_path / "live.ply", "--calibration", curve)[0] == 0
    assert not curve.exists()


def test_part_and_fineness_are_asked_of_the_daemon(
    tmp_path: Path, export: Call, watched: Watched
) -> None:
    words = ["--level", "2", "--radius", "25.5", "--box=-8,-7,-6,8,7,6"]
    watched.served.blocks.clear()  # it sends finer blocks than requested
    code, lines, _ = export(tmp_path / "live.ply", *words)
    assert code == 0, lines
    assert watched.served.hellos[0].interest == Interest(
        level=2, radius_m=25.5, box=MapBox((-8.0, -7.0, -6.0), (8.0, 7.0, 6.0))
    )


def test_place_on_earth_is_the_maps(tmp_path: Path, export: Call, watched: Watched) -> None:
    watched.served.info = replace(MAP_INFO, origin_deg=(-33.9, 151.2))
    code, lines, _ = export(tmp_path / "live.laz")
    assert (code, lines[1]) == (0, "coordinate reference system: WGS 84 / UTM zone 56S, EPSG:32756")
    assert laspy.read(tmp_path / "live.laz").header.parse_crs().to_epsg() == 32756
    assert "32N" in export(tmp_path / "live.laz", "--origin", "54.3,10.1")[1][1]
    reported = json.loads(export(tmp_path / "live.laz", "--json")[1][0])
    size = (tmp_path / "live.laz").stat().st_size
    assert reported == {
        "files": {str(tmp_path / "live.laz"): size},
        "crs": "WGS 84 / UTM zone 56S, EPSG:32756",
    }


@pytest.mark.parametrize("suffix", [".ply", ".mcap"])
def test_map_that_does_not_come_whole_is_no_file(
    tmp_path: Path, export: Call, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    def send(self: Connection) -> None:
        one = BlockSet(
            np.zeros((1, 3), np.int32), np.zeros(1, np.uint32), a_block(3).reshape(1, CELLS)
        )
        self.send(BlocksMessage(revision=3, stamp_ns=10**18, left=3, body=encode_blocks(one)))

    monkeypatch.setattr(Connection, "publish", send)
    code, lines, output = export(tmp_path / f"live{suffix}", "--timeout", "0.3")
    assert (code, lines) == (75, [])
    assert re.search(r"0\.3 s: 25 %, 3 blocks left, 0\.0 MiB", output)
    assert list(tmp_path.iterdir()) == []


def test_daemon_that_is_not_there_is_reported_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = tmp_path / "map.sock"
    assert main(["export", str(tmp_path / "a.ply"), "--socket", str(nowhere)]) == 69
    error = capsys.readouterr().err
    assert error.startswith(f"mapperctl: {nowhere}: no daemon answers: No such file or directory; ")
    assert "check that mapperd runs" in error


@pytest.mark.parametrize(
    ("reason", "code"), [("wrong_token", 77), ("bad_version", 76), ("bad_interest", 76)]
)
def test_daemon_that_refuses_is_reported(
    tmp_path: Path, export: Call, watched: Watched, reason: str, code: int
) -> None:
    watched.served.refusal = ByeMessage(reason=reason, message="it will not")
    assert (reported := export(tmp_path / "live.ply"))[0] == code
    assert "it will not" in reported[2]
    assert list(tmp_path.iterdir()) == []


def test_empty_map_is_reported(tmp_path: Path, export: Call, watched: Watched) -> None:
    watched.served.blocks.clear()
    assert export(tmp_path / "live.ply")[0] == 0
    code, _, output = export(tmp_path / "live.tif")
    assert (code, "no occupied voxel" in output) == (73, True)


def test_recording_holds_the_map_that_was_reported(
    tmp_path: Path, export: Call, watched: Watched
) -> None:
    path = tmp_path / "live.mcap"
    path.write_bytes(b"an older one")
    (tmp_path / ".live.mcap.partial").write_bytes(b"of somebody who was killed")
    code, lines, _ = export(path)
    assert (code, lines) == (0, [f"{path}: {path.stat().st_size} bytes"])
    assert list(tmp_path.iterdir()) == [path]
    assert watched.served.hellos[0].wants == ["map", "pose", "path", "fan"]
    _, cloud = read(path)["/map"][-1]
    assert len(cloud.data) // cloud.point_stride == len(watched.mirror().cells())


@pytest.mark.parametrize("words", [["--origin", "1,2"], ["--min-probability", "0.6"]])
def test_recording_is_as_received(
    tmp_path: Path, export: Call, watched: Watched, words: list[str]
) -> None:
    code, _, output = export(tmp_path / "live.mcap", *words)
    assert (code, "knows neither" in output) == (73, True)
    assert watched.served.hellos == []


def test_name_without_a_format_is_refused_before_anybody_is_asked(
    tmp_path: Path, export: Call, watched: Watched
) -> None:
    assert export(tmp_path / "live.obj")[0] == 73
    assert watched.served.hellos == []


def test_progress_is_a_line_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("mapperd.cli.mapperctl.export.time.monotonic", lambda: now[0])
    progress = _ExportProgress(sys.stderr)
    assert progress.text() == "nothing received"
    for now[0], came, left in ((4.0, 10, 90), (6.0, 50, 50), (7.0, 99, 1), (12.0, 99, 1)):
        progress.received, progress.left = came, left
        progress.show(3 << 20)
    progress.end()
    assert capsys.readouterr().err.splitlines() == [
        "mapperctl: 50 %, 50 blocks left, 3.0 MiB",
        "mapperctl: 99 %, 1 blocks left, 3.0 MiB",
    ]


def test_levels_are_those_of_the_stream() -> None:
    assert parser().parse_args(["export", "a.ply", "--level", str(MAX_LEVEL)]).level == MAX_LEVEL
    with pytest.raises(SystemExit):
        parser().parse_args(["export", "a.ply", "--level", str(MAX_LEVEL + 1)])


@pytest.mark.parametrize("words", [["--box", "1,1,1,0,2,2"], ["--box", "1"], ["--radius", "-1"]])
def test_numbers_that_cannot_be_are_refused(words: list[str]) -> None:
    with pytest.raises(SystemExit):
        parser().parse_args(["export", "a.ply", *words])


def test_a_map_with_holes_is_refused_unless_asked_for(
    tmp_path: Path, export: Call, watched: Watched
) -> None:
    watched.served.info = replace(watched.served.info, bricks_lost=2)
    path = tmp_path / "live.ply"
    code, lines, error = export(path)
    assert (code, lines, path.exists()) == (1, [], False)
    assert "2 damaged bricks" in error
    code, lines, _ = export(path, "--allow-damaged")
    assert (code, lines[-1].startswith("2 damaged bricks"), path.exists()) == (0, True, True)
    code, lines, _ = export(path, "--allow-damaged", "--json")
    assert json.loads(lines[0])["bricks_lost"] == 2
