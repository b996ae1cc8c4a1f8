"""The daemon dies at any instant; what the next one makes of it is what was recorded, to the bit.

`make crash-soak` does it 500 times.
"""

import contextlib
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.cli.replay import _replayed
from mapperd.config.loader import config_from_text
from mapperd.config.tree import Config
from mapperd.errors import StoreError
from mapperd.events import EventLog
from mapperd.export.trajectory import TrajectoryWriter
from mapperd.mapping.sonar_map import SonarMap
from mapperd.session.recordings import files_in, sessions_of
from mapperd.session.replay import Run, Window
from mapperd.session.replay import as_recorded as run_as_recorded
from mapperd.session.replay_to_store import map_into_store
from mapperd.session.startup import open_map
from mapperd.store.position import position_in
from mapperd.store.reader import StoreReader
from oculus_driver import Faults
from tests.mapperd.conftest import BEAMS, ROWS, WALL_ROW, make_ping
from tests.mapperd.session.crash.client import ROOT, Daemons, World

pytestmark = pytest.mark.crash

KILLS = int(os.environ.get("CRASH_KILLS", "50"))


NOISY = Faults(cut=0.01, garbage=0.05, flip=0.05, piece_bytes=700)
"""Of a sonar whose messages come in pieces, with noise between them and lost connections inside."""


@pytest.fixture
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    asked = getattr(request, "param", None)
    world = World(walls()) if asked == "arc" else World(faults=asked)
    yield world
    world.close()


@pytest.fixture
def daemons(tmp_path: Path) -> Iterator[Daemons]:
    daemons = Daemons(tmp_path / "log")
    yield daemons
    daemons.close()


def walls() -> list[bytes]:
    """Pings that see a wall whose level changes, as the arc rule looks at it."""
    pings = []
    for k in range(1, 200):
        image = np.zeros((ROWS, BEAMS), dtype=np.uint8)
        image[WALL_ROW : WALL_ROW + 2] = 20 + 3 * (k % 10)
        pings.append(make_ping(k, start_time=100 + 0.02 * k, image=image))
    return pings


def settings_of(world: World, folder: Path, rule: str = "iwlo") -> str:
    return (
        f"mapping: {{rule: {rule}}}\n"
        "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
        f"device: {{address: 127.0.0.1, port: {world.sonar_port}, ping_rate: highest}}\n"
        f"odometry: {{sources: [{{link: 'udp://127.0.0.1:{world.odometry_port}'}}]}}\n"
        f"outofcore: {{use: true, map_path: {folder}/dive.map, tile_size: 6.4, cache_size: 2}}\n"
        f"recording: {{folder: {folder}/recordings, free_floor: 0, max_file: 1, budget: 0}}\n"
        f"server: {{socket: {folder}/control}}\n"
        "visualization: {tile_save_interval: 0.1}\n"
    )


def content(path: Path, config: Config) -> str:
    sonar_map = SonarMap(config)
    with StoreReader(path) as reader:
        reader.load(sonar_map)
    return sonar_map.sha256()


def as_recorded(folder: Path) -> tuple[str, int]:
    """The map of all recordings in a folder as a whole, and its pings."""
    begun = [session for session in sessions_of(files_in([folder])) if any(True for _ in session)]
    runs = [run_as_recorded(session) for session in begun]
    sonar_map = SonarMap(runs[0].config)
    with contextlib.closing(TrajectoryWriter(folder)) as trajectory:
        summary = _replayed(runs, sonar_map, Window(), trajectory)(sonar_map)
    return sonar_map.sha256(), summary["pings_mapped"]


def recovered(config: Config) -> EventLog:
    events = EventLog(time.time_ns)
    open_map(config, "none", events, os.environ, lambda: 1.0).close()
    return events


def size_of(path: Path) -> int:
    """Bytes of a file; 0 for a journal that has just gone."""
    with contextlib.suppress(FileNotFoundError):
        return path.stat().st_size
    return 0


def runs(process: int) -> bool:
    """Whether a daemon has not ended yet."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def wait_for_bytes(process: int, folder: Path, names: str, more: int) -> bool:
    """Wait until a daemon's files have grown by so much; returns False if it ends before.

    A busy machine takes seconds to start one: who waits too briefly kills what has not begun.
    """
    begin = None
    until_s = time.monotonic() + 60
    while time.monotonic() < until_s and runs(process):
        size = sum(map(size_of, folder.glob(names))) if folder.exists() else 0
        begin = size if begin is None else begin
        if size - begin >= more:
            return True
        time.sleep(0.003)
    return False


def wait_for(condition: Callable[[], bool], process: int) -> bool:
    """Wait for a condition; returns False if the daemon ends before."""
    until_s = time.monotonic() + 120
    while time.monotonic() < until_s and runs(process):
        with contextlib.suppress(StoreError):  # it is being created
            if condition():
                return True
        time.sleep(0.01)
    return False


def mid_session(path: Path) -> bool:
    """Whether the file was saved since its session began, and the session goes on."""
    if not path.exists():
        return False
    try:
        reader = StoreReader(path)
    except StoreError as error:
        if "is of version 0" in str(error):  # killed before the file had its tables
            return False
        raise
    with reader:
        (data,) = reader._connection.execute("SELECT position FROM progress").fetchone() or (b"",)
    position = position_in(bytes(data))
    return position is not None and not position.whole and position.done + position.place.file > 0


@pytest.mark.parametrize(
    ("world", "rule"),
    [
        pytest.param(None, "iwlo", id="calm"),
        pytest.param(NOISY, "iwlo", id="noisy", marks=pytest.mark.slow),
        pytest.param("arc", "arc", id="arc"),
    ],
    indirect=["world"],
)
@pytest.mark.timeout(1200)
def test_map_after_a_kill_is_that_of_the_recordings(
    tmp_path: Path, world: World, daemons: Daemons, rule: str
) -> None:
    chance = random.Random(11)  # noqa: S311 for the instants
    mid = folders = mapped = kills = 0
    while kills < KILLS:
        folder = tmp_path / str(kills)
        folder.mkdir()
        text = settings_of(world, folder, rule)
        (folder / "live.yaml").write_text(text, encoding="utf-8")
        config = config_from_text(text)
        for _ in range(chance.randint(1, 3)):
            process = daemons.start("--config", folder / "live.yaml", "--out", folder / "out")
            kind = chance.random()
            if kind < 0.9:  # by what is written, not by time: load shifts that
                more = chance.randint(1, 300_000)
                assert wait_for_bytes(process, folder / "recordings", "*", more)
            if is_saved := kind < 0.7:
                assert wait_for(partial(mid_session, folder / "dive.map"), process)
            time.sleep(chance.uniform(0.0, 0.1))
            os.kill(process, signal.SIGKILL)
            assert daemons.ended() == -signal.SIGKILL
            kills += 1
        path = folder / "dive.map"
        assert mid_session(path) or not is_saved
        mid += mid_session(path)
        folders += 1
        recordings = folder / "recordings"
        if not path.exists() or not recordings.exists() or not files_in([recordings]):
            continue
        recovered(config)
        reference, pings = as_recorded(recordings)
        assert content(path, config) == reference, f"{folder} {pings} pings"
        mapped += pings
    print(f"{kills} kills, {mid} of {folders} maps in a session, {mapped} pings, all equal")  # noqa: T201
    assert mapped > 10 * KILLS


def test_a_session_killed_soon_after_its_start_needs_no_write_ahead_log(
    tmp_path: Path, world: World, daemons: Daemons
) -> None:
    chance = random.Random(13)  # noqa: S311 for the instants
    for number in range(max(KILLS // 10, 2)):
        folder = tmp_path / str(number)
        folder.mkdir()
        text = settings_of(world, folder)
        (folder / "live.yaml").write_text(text, encoding="utf-8")
        process = daemons.start("--config", folder / "live.yaml", "--out", folder / "out")
        assert wait_for_bytes(process, folder / "recordings", "*", chance.randint(1, 100_000))
        os.kill(process, signal.SIGKILL)
        assert daemons.ended() == -signal.SIGKILL
        for suffix in ("-wal", "-shm"):
            (folder / f"dive.map{suffix}").unlink(missing_ok=True)
        config = config_from_text(text)
        with StoreReader(folder / "dive.map") as reader:
            position = position_in(reader.load(SonarMap(config)).position)
        assert position is not None
        recovered(config)
        assert content(folder / "dive.map", config) == as_recorded(folder / "recordings")[0]


@pytest.mark.parametrize(
    ("world", "rule"), [(None, "iwlo"), ("arc", "arc")], indirect=["world"], ids=["iwlo", "arc"]
)
def test_who_is_reported_to_end_leaves_a_whole_map(
    tmp_path: Path, world: World, daemons: Daemons, rule: str
) -> None:
    text = settings_of(world, tmp_path, rule)
    (tmp_path / "live.yaml").write_text(text, encoding="utf-8")
    for _ in range(2):
        process = daemons.start("--config", tmp_path / "live.yaml", "--out", tmp_path / "out")
        assert wait_for_bytes(process, tmp_path / "recordings", "*", 100_000)  # some 28 pings
        os.kill(process, signal.SIGTERM)
        assert daemons.ended() == 0
    reference, pings = as_recorded(tmp_path / "recordings")
    assert pings > 20
    config = config_from_text(text)
    assert content(tmp_path / "dive.map", config) == reference
    assert not mid_session(tmp_path / "dive.map")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["map_sha256"] == reference
    assert summary["rule"] == rule
    if rule == "arc":
        assert summary["surface_returns"] > 20
        assert 20 < summary["surface_level"] < 80
    codes = [event.code for event in recovered(config).since(0)[0]]
    assert codes == ["map_continued"]  # and nothing was missing


def test_a_session_without_space_is_refused_or_keeps_its_map(
    tmp_path: Path, world: World, daemons: Daemons
) -> None:
    text = settings_of(world, tmp_path).replace("free_floor: 0", "free_floor: 1000000000")
    settings = tmp_path / "live.yaml"
    settings.write_text(text, encoding="utf-8")
    daemons.start("--config", settings, "--out", tmp_path / "out")
    assert daemons.ended() == 73
    settings.write_text(text.replace("free_floor", "require_space: false, free_floor"), "utf-8")
    daemons.start("--config", settings, "--out", tmp_path / "out", "--duration", "5")
    assert daemons.ended() == 73  # the session is not recorded
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["voxels_occupied"] > 0
    assert summary["store"]["loss"] is None
    assert summary["live"]["recording"]["bytes_dropped"] > 0
    assert content(tmp_path / "dive.map", config_from_text(text)) == summary["map_sha256"]
    log = (tmp_path / "log").read_text(encoding="utf-8")
    assert "no space to keep a session" in log
    assert "are not recorded" in log


DEMO = ROOT / "out" / "demo" / "capture.bin"
DEMO_BYTES = 60_000_000

REPLAY = (
    "octree: {voxel_resolution: 0.2}\nmounting: {orientation: {pitch: 0}}\n"
    "outofcore: {tile_size: 6.4, cache_size: 2}\nvisualization: {tile_save_interval: 0.02}\n"
)


def test_replay_into_a_file_goes_on_after_a_kill(
    tmp_path: Path,
    daemons: Daemons,
    survey: Callable[..., list[Any]],
    write_recording: Callable[..., object],
) -> None:
    write_recording(tmp_path / "dive.mcap", survey(400))  # a quarter of a megabyte of map
    (tmp_path / "dive.yaml").write_text(REPLAY, encoding="utf-8")
    kill_replays(tmp_path, daemons, KILLS // 2)


@pytest.mark.skipif(not DEMO.exists(), reason=f"no {DEMO.name}: `make demo` records it")
def test_demo_mapped_at_full_speed_goes_on_after_a_kill(tmp_path: Path, daemons: Daemons) -> None:
    with DEMO.open("rb") as demo:  # its first seconds: a cut recording is one all the same
        (tmp_path / "dive.mcap").write_bytes(demo.read(DEMO_BYTES))
    settings = (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8")
    stored = "\noutofcore: {tile_size: 6.4}\nvisualization: {tile_save_interval: 0.1}\n"
    (tmp_path / "dive.yaml").write_text(settings + stored, encoding="utf-8")
    kill_replays(tmp_path, daemons, KILLS)


def kill_replays(folder: Path, daemons: Daemons, least: int) -> None:
    """Kill and go on, again and again; every map that is carried to its end is the whole one."""
    chance = random.Random(12)  # noqa: S311
    dive, store = folder / "dive.mcap", folder / "dive.map"
    config = config_from_text((folder / "dive.yaml").read_text(encoding="utf-8"))
    (session,) = sessions_of([dive])
    truth = SonarMap(config)
    with contextlib.closing(TrajectoryWriter(folder)) as trajectory:
        runs = [Run(session, config, None, None)]
        whole = _replayed(runs, truth, Window(), trajectory)(truth)
    assert whole["pings_mapped"] > 40
    words = ("--replay", dive, "--config", folder / "dive.yaml", "--store", store)
    kills = mid = ends = 0
    while kills < least or not ends:
        process = daemons.start(*words, "--out", folder / "out")
        if chance.random() < 0.9:
            wait_for_bytes(process, folder, "dive.map*", chance.randint(1, 100_000))
        time.sleep(chance.uniform(0.0, 0.1))
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        if daemons.ended() == -signal.SIGKILL:
            kills += 1
            mid += mid_session(store)
        if store.exists() and chance.random() < 0.2:  # go on to the end, in this process
            ends += 1
            map_into_store([dive], config, None, store)
            assert content(store, config) == truth.sha256(), kills
            for left in folder.glob("dive.map*"):
                left.unlink()
    assert mid > least / 4
