"""Pings mapped at localized poses: closer to the truth, bit-exact in replay and after kills."""

import math
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from mapperd.config.loader import config_from_text
from mapperd.mapping.sonar_map import SonarMap
from mapperd.pipeline.counters import PipelineCounters
from mapperd.session.replay_to_store import map_into_store
from mapperd.store.position import position_in
from mapperd.store.reader import StoreReader
from tests.mapperd.conftest import Ran
from tests.mapperd.localization.room import (
    Dive,
    Floats,
    Recorder,
    dive,
    events,
    room,
    settings,
    write_room,
)

Runs = Callable[..., Ran]

pytestmark = pytest.mark.usefixtures("no_picture")


@pytest.fixture
def recording(tmp_path: Path, write_recording: Recorder) -> Path:
    path = tmp_path / "dive.mcap"
    write_recording(path, events(room(), dive()))
    return path


def written(folder: Path, **ours: object) -> Path:
    path = folder / "settings.yaml"
    path.write_text(settings(write_room(folder), **ours), encoding="utf-8")
    return path


def share_in_place(folder: Path, out: Path) -> float:
    """Of the occupied voxels, those that lie within one of a wall."""
    sonar_map = SonarMap(config_from_text((folder / "settings.yaml").read_text("utf-8")))
    sonar_map.load_octomap((out / "map.bt").read_bytes())
    centres: Floats = sonar_map.voxels("occupied").centres_m
    grid = room()
    walls = grid.centres_m(*np.nonzero(grid.occupancy == 100))
    flat = np.unique(centres[:, :2], axis=0)
    nearest = np.array([np.hypot(*(walls - one).T).min() for one in flat])
    return float((nearest < 0.15 * math.sqrt(2)).mean())


@pytest.mark.slow
def test_corrected_pings_lie_nearer_the_truth(tmp_path: Path, recording: Path, run: Runs) -> None:
    shares = {}
    for mapping in ("odometry", "corrected"):
        ran = run(recording, config=written(tmp_path, mapping=mapping))
        assert ran.code == 0, ran.output
        shares[mapping] = share_in_place(tmp_path, ran.out)
        reported = ran.summary["localization"]
        assert reported["state"] == "localizing"
        assert reported["updates"] > 100
        truth = dive().truth[-1]
        assert (
            math.hypot(reported["pose"]["x_m"] - truth[0], reported["pose"]["y_m"] - truth[1]) < 0.3
        )
    assert shares["corrected"] > 0.8
    assert shares["odometry"] < 0.65


def test_localize_only_maps_nothing_and_is_no_failure(
    tmp_path: Path, recording: Path, run: Runs
) -> None:
    ran = run(recording, config=written(tmp_path, mapping="off"))
    assert ran.code == 0, ran.output
    assert ran.summary["pings_mapped"] == 0
    assert ran.summary["pings_dropped"] == {"mapping_off": 120}
    assert ran.summary["localization"]["updates"] > 100


def test_pings_before_the_first_belief_are_held_out(
    tmp_path: Path, recording: Path, run: Runs
) -> None:
    path = written(tmp_path, mapping="corrected")
    text = path.read_text("utf-8").replace("set_initial_pose: true", "set_initial_pose: false")
    path.write_text(text, encoding="utf-8")
    ran = run(recording, config=path)
    assert ran.summary["pings_dropped"] == {"not_localized": 120}
    assert ran.summary["localization"]["state"] == "waiting for a pose"


@pytest.mark.parametrize("bound", ["mapping_max_std", "mapping_max_std_yaw"])
def test_unsure_estimate_is_invalid_to_map_by(
    bound: str, tmp_path: Path, recording: Path, run: Runs
) -> None:
    ran = run(recording, config=written(tmp_path, mapping="corrected", **{bound: 0.001}))
    assert ran.summary["pings_dropped"] == {"unsure": 120}


def test_missing_map_is_one_clear_message(tmp_path: Path, recording: Path, run: Runs) -> None:
    path = written(tmp_path)
    (tmp_path / "room.yaml").unlink()
    ran = run(recording, config=path)
    assert ran.code == 78
    (line,) = ran.output.strip().splitlines()
    assert "$.localization.map_path" in line
    assert "room.yaml" in line


@pytest.mark.slow
def test_vehicle_is_followed_on_the_3d_map_of_an_earlier_dive(
    tmp_path: Path, recording: Path, run: Runs, write_recording: Recorder
) -> None:
    """The earlier dive knew where it was; its map lies in a file on disk."""
    true = dive()
    write_recording(tmp_path / "true.mcap", events(room(), Dive(true.truth, true.truth)))
    path = written(tmp_path, mapping="odometry")
    text = path.read_text("utf-8").replace("mode: track", "mode: 'off'")
    map_into_store([tmp_path / "true.mcap"], config_from_text(text), None, tmp_path / "earlier.map")
    start = {"mapping_max_std_yaw": 15.0}  # its heading is not known better at first
    path.write_text(settings(tmp_path / "earlier.map", mapping="corrected", **start), "utf-8")
    ran = run(recording, config=path)
    assert ran.code == 0, ran.output
    assert ran.summary["pings_mapped"] > 110
    pose = ran.summary["localization"]["pose"]
    assert math.dist((pose["x_m"], pose["y_m"]), true.truth[-1][:2]) < 0.3


class Interrupted(Exception):  # noqa: N818 no error of ours
    """As a kill between two chunks."""


@pytest.mark.slow
def test_map_after_interruptions_is_that_of_the_whole(tmp_path: Path, recording: Path) -> None:
    """Interrupted at any chunk, with saves in between: the particles go on as they were."""
    path = written(tmp_path, mapping="corrected")
    stored = "outofcore: {tile_size: 6.4}\nvisualization: {tile_save_interval: 0.01}\n"
    config = config_from_text(path.read_text("utf-8") + stored)
    whole, _, counters, _ = map_into_store([recording], config, None, tmp_path / "whole.map")
    assert counters.pings_mapped > 110
    chance, store = Random(3), tmp_path / "cut.map"  # noqa: S311
    mid = cuts = 0
    while cuts < 12:
        left = chance.randrange(5, 60)

        def cut(_: PipelineCounters) -> None:
            nonlocal left
            left -= 1
            if left == 0:
                raise Interrupted

        try:
            map_into_store([recording], config, None, store, cut)
            break
        except Interrupted:
            cuts += 1
            mid += passed_over(store) > 0
    mapped, *_ = map_into_store([recording], config, None, store)
    assert mapped.sha256() == whole.sha256()
    assert mid > 2


def test_file_stays_empty_where_nothing_is_to_be_mapped(tmp_path: Path, recording: Path) -> None:
    config = config_from_text(written(tmp_path, mapping="off").read_text("utf-8"))
    mapped, _, counters, _ = map_into_store([recording], config, None, tmp_path / "cut.map")
    assert counters.pings_dropped == {"mapping_off": 120}
    assert mapped.counts().occupied == 0


def passed_over(store: Path) -> int:
    """Pieces of work that are in the file since its checkpoint."""
    with StoreReader(store) as reader:
        (data,) = reader._connection.execute("SELECT position FROM progress").fetchone() or (b"",)
    position = position_in(bytes(data))
    return 0 if position is None else position.done
