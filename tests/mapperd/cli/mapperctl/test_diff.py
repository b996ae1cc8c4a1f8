"""`mapperctl diff`."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import plyfile

from tests.support.maps import FREE, OCCUPIED, map_of

Call = Callable[..., tuple[int, list[str], str]]


def saved(folder: Path) -> tuple[Path, Path]:
    a, b = folder / "a.map", folder / "b.bt"
    map_of(OCCUPIED, FREE).save(a)
    map_of([*OCCUPIED[1:], FREE[0]], [*FREE[1:], OCCUPIED[0]]).save_octomap(b)
    return a, b


def test_both_ways_as_text_and_json(tmp_path: Path, call: Call) -> None:
    a, b = saved(tmp_path)
    code, lines, _ = call("diff", a, b, "--tolerance", "0.25")
    assert code == 0
    assert lines[2:6] == [
        "same      2 (66.7%) of B within 0.25 m",
        "appeared  1 (33.3%) of B where A had observed the place",
        "vanished  1 (33.3%) of A where B has observed the place",
        "not seen  0 (0.0%) of B by A, 0 (0.0%) of A by B",
    ]
    code, lines, _ = call("diff", a, b, "--tolerance", "0.25", "--json")
    found = json.loads(lines[0])
    assert (found["a"]["vanished"], found["b"]["appeared"], found["b"]["same"]) == (1, 1, 2)
    assert found["tolerance_m"] == 0.25


def test_a_coloured_cloud(tmp_path: Path, call: Call) -> None:
    a, b = saved(tmp_path)
    assert call("diff", a, b, "--tolerance", "0.25", "--out", tmp_path / "diff.ply")[0] == 0
    points = plyfile.PlyData.read(str(tmp_path / "diff.ply"))["vertex"]
    assert sorted(points["class"]) == [0, 0, 1, 2]
    (gone,) = np.flatnonzero(points["class"] == 2)
    np.testing.assert_allclose([points[axis][gone] for axis in "xyz"], OCCUPIED[0])
    assert points["red"][gone] > points["green"][gone]


def test_what_cannot_be_compared_is_one_line(tmp_path: Path, call: Call) -> None:
    a, b = saved(tmp_path)
    code, _, error = call("diff", a, tmp_path / "none.map")
    assert (code, "no such file" in error) == (66, True)
    code, _, error = call("diff", a, b, "--tolerance", "100")
    assert (code, "at most 15 m" in error) == (2, True)
    code, _, error = call("diff", a, b, "--out", tmp_path / "diff.xyz")
    assert (code, ".ply" in error) == (73, True)
