"""The dives of the survey's study: overlapping, described correctly, and reproducible."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mapper_survey.request import read_survey
from numpy.typing import NDArray
from sonar_sim.errors import SceneError
from studies.survey.dives import ALTITUDE_M, DEPTH_M, FULL, PAUSE_S, SMALL, SimulatedDive, dives
from studies.survey.make_dives import cut, flip, record, record_all, write_survey

from oculus_driver.recording import describe, open_recording


def short() -> SimulatedDive:
    """A few pings of the small plan's first dive."""
    dive = dives(SMALL)[0]
    path = {
        "waypoints": [{"position_m": [x_m, 0.0, -24.0]} for x_m in (0.0, 4.0)],
        "speed_mps": 2.5,
    }
    return replace(dive, scene={**dive.scene, "trajectory": path})


@pytest.fixture(name="full", scope="module")
def full_fixture() -> list[SimulatedDive]:
    """The dives of two hours."""
    return dives(FULL)


def lines(dive: SimulatedDive) -> NDArray[np.float64]:
    """Corners of a dive's path, (6, 3)."""
    waypoints = dive.scene["trajectory"]["waypoints"]
    return np.array([waypoint["position_m"] for waypoint in waypoints])


def test_the_full_survey_has_ten_dives_of_two_hours_one_after_the_other(
    full: list[SimulatedDive],
) -> None:
    assert len({dive.name for dive in full}) == 10
    assert sum(dive.duration_s for dive in full) >= 7200
    for before, after in pairwise(full):
        assert after.start_s == pytest.approx(before.start_s + before.duration_s + PAUSE_S)


def test_dives_lie_beside_each_other_and_others_cross_all_of_them(
    full: list[SimulatedDive],
) -> None:
    first, second, crossing = (lines(full[k]) for k in (0, 1, FULL.along))
    assert second[0, 1] - first[-1, 1] == FULL.beside_m
    assert np.ptp(crossing[:, 1]) == FULL.width_m
    assert np.all((crossing[:, 0] > 0) & (crossing[:, 0] < FULL.leg_m))
    assert {first[0, 2], crossing[0, 2]} == {ALTITUDE_M - DEPTH_M}


def test_a_recording_is_the_same_each_time_and_is_not_made_twice(tmp_path: Path) -> None:
    dive = short()
    heard: list[tuple[int, int]] = []
    path = record(dive, tmp_path / "a", lambda *pings: heard.append(pings))
    assert path.read_bytes() == record(dive, tmp_path / "b").read_bytes()
    with open_recording(path) as recording:
        assert describe(recording).pings == len(heard) > 0
    assert heard == [(k + 1, len(heard)) for k in range(len(heard))]
    heard.clear()
    record(dive, tmp_path / "a", lambda *pings: heard.append(pings))
    assert heard == []


@pytest.mark.slow
def test_processes_make_the_same_recordings(tmp_path: Path) -> None:
    todo = [replace(short(), name=name, seed=seed) for seed, name in enumerate("ab")]
    made = record_all(todo, tmp_path / "processes", 2)
    alone = [record(dive, tmp_path / "alone") for dive in todo]
    assert [path.name for path in made] == ["a.mcap", "b.mcap"]
    assert [path.read_bytes() for path in made] == [path.read_bytes() for path in alone]
    assert made[0].read_bytes() != made[1].read_bytes()


@pytest.mark.slow
def test_a_dive_that_cannot_be_made_ends_the_making(tmp_path: Path) -> None:
    wrong = replace(short(), scene={**short().scene, "sonar": {"range_m": 1e9}})
    with pytest.raises(SceneError, match="range"):
        record_all([wrong] * 4, tmp_path, 1)


def test_another_dive_under_the_same_name_is_recorded_again(tmp_path: Path) -> None:
    dive = short()
    (tmp_path / "dive-01.mcap").write_bytes(b"of another plan")
    (tmp_path / "dive-01.yaml").write_text("{}")
    assert record(dive, tmp_path).stat().st_size > 1000
    assert json.loads((tmp_path / "dive-01.yaml").read_text()) == dive.scene


def test_a_recording_that_was_not_finished_is_not_there(
    tmp_path: Path,
) -> None:
    def stop(_done: int, _of: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(short(), tmp_path, stop)
    assert not (tmp_path / "dive-01.mcap").exists()


def test_the_survey_file_names_recordings_and_settings_from_where_it_lies(tmp_path: Path) -> None:
    recordings = [tmp_path / "dives" / f"dive-0{k}.mcap" for k in (1, 2)]
    (tmp_path / "dives").mkdir()
    for recording in recordings:
        recording.touch()
    request = read_survey(write_survey(tmp_path, recordings))
    assert [request.path_of(dive) for dive in request.survey.dives] == recordings
    stated, mounting = request.config.mounting, short().scene["mounting"]
    assert request.config.octree.voxel_resolution == 0.1
    assert [stated.position.x, stated.position.y, stated.position.z] == mounting["position_m"]
    assert stated.orientation.pitch == mounting["pitch_deg"]


def test_a_cut_copy_is_the_beginning_of_the_recording(tmp_path: Path) -> None:
    recording = tmp_path / "whole"
    recording.write_bytes(np.random.default_rng(5).bytes(3_000_000))
    done = cut(recording, tmp_path / "copies" / "cut", seed=1)
    assert done.copy.read_bytes() == recording.read_bytes()[: done.places[0]]
    assert 900_000 <= done.places[0] <= 2_100_000


def test_flipped_bytes_are_those_that_are_reported(tmp_path: Path) -> None:
    recording = tmp_path / "whole"
    recording.write_bytes(np.random.default_rng(5).bytes(100_000))
    done = flip(recording, tmp_path / "copies" / "flipped", seed=1, flips=7)
    before, after = (np.fromfile(path, np.uint8) for path in (recording, done.copy))
    changed = np.flatnonzero(before != after)
    assert changed.tolist() == list(done.places)
    assert np.all(after[changed] == 255 - before[changed])
    assert len(changed) == 7
