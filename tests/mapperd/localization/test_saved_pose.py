import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapperd.errors import ExportError, MapError
from mapperd.geometry.gaussian import PlanarGaussian
from mapperd.localization.saved_pose import SavePace, load_pose, save_pose

COVARIANCE = np.array([[0.3, 0.1, 0.01], [0.1, 0.2, 0.02], [0.01, 0.02, 0.05]])
POSE = PlanarGaussian(1.1, -2.25, 3.0, COVARIANCE)


def test_saved_pose_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    save_pose(path, PlanarGaussian(9, 9, 0, np.zeros((3, 3))), "map", 1)
    save_pose(path, POSE, "map", 2)
    again = load_pose(path, "map")
    assert again is not None
    assert (again.x_m, again.y_m, again.yaw_rad) == (1.1, -2.25, 3.0)
    assert again.covariance.tobytes() == POSE.covariance.tobytes()
    assert [found.name for found in tmp_path.iterdir()] == ["pose.json"]


def test_no_file_is_no_pose(tmp_path: Path) -> None:
    assert load_pose(tmp_path / "pose.json", "map") is None


def broken(**changes: Any) -> str:
    tree: dict[str, Any] = {
        "frame": "map",
        "saved_unix_ns": 1,
        "mean": [1, 2, 3],
        "covariance": COVARIANCE.tolist(),
        "version": 1,
    }
    return json.dumps(tree | changes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no saved pose"),
        (broken()[:-9], "no saved pose"),
        (broken(version=2), "no saved pose"),
        (broken(frame="other"), "a pose in 'other', the map is 'map'"),
        (broken(mean=[1, 2]), "no saved pose"),
        (broken(mean=[1, 2, 1e9]), "heading"),
        (broken(covariance=(-COVARIANCE).tolist()), "semi-definite"),
        (broken().replace("1,", "1e999,"), "no saved pose"),
        (broken(more=1), "no saved pose"),
        (broken(frame="m" * 5000), "no saved pose"),
    ],
)
def test_damaged_files_are_reported_and_not_believed(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "pose.json"
    path.write_text(text)
    with pytest.raises(MapError, match=words) as caught:
        load_pose(path, "map")
    assert caught.value.reason == "bad_saved_pose"


def test_sound_file_of_another_writer_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    path.write_text(broken())
    assert load_pose(path, "map") is not None


def test_failed_save_leaves_the_last_one(tmp_path: Path) -> None:
    with pytest.raises(ExportError):
        save_pose(tmp_path / "no" / "pose.json", POSE, "map", 1)
    with pytest.raises(MapError, match="cannot be read"):
        load_pose(tmp_path, "map")


def test_pace_is_that_of_the_rate() -> None:
    pace = SavePace(0.5)
    assert pace.is_due(100.0)
    pace = pace.saved(100.0)
    assert [pace.is_due(now) for now in (100.0, 101.9, 102.0, 103.0)] == [False, False, True, True]


@pytest.mark.parametrize("rate_hz", [0.0, -1.0])
def test_no_rate_never_saves(rate_hz: float) -> None:
    assert not SavePace(rate_hz).is_due(1e9)
