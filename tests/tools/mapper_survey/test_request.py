"""`survey.yaml` is accepted, or refused with one line that names the error and its place."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mapper_survey.command import main
from mapper_survey.errors import SurveyError
from mapper_survey.memory import bytes_of, edge_for, voxel_bytes_of
from mapper_survey.request import DiveTransform, read_survey

from oculus_driver.command_line import ExitCode

DIVES = [{"name": "a", "recording": "a.mcap"}]


def written(folder: Path, reported: object) -> Path:
    path = folder / "survey.yaml"
    (folder / "a.mcap").touch()
    path.write_text(
        reported if isinstance(reported, str) else json.dumps(reported), encoding="utf-8"
    )
    return path


def test_settings_of_the_file_lie_below_those_of_the_survey(tmp_path: Path) -> None:
    (tmp_path / "mapperd.yaml").write_text(
        "octree: {voxel_resolution: 0.3}\nfiltering: {min_range: 2.0}\n", encoding="utf-8"
    )
    settings = {"octree": {"voxel_resolution": 0.2}, "mapping.integrator": "rays"}
    reported = {"dives": DIVES, "configuration": "mapperd.yaml", "settings": settings}
    origin = {"latitude": 53.5, "longitude": 8.0, "altitude": 1.5}
    request = read_survey(written(tmp_path, reported | {"origin": origin}))
    config = request.config
    assert config.octree.voxel_resolution == 0.2
    assert config.filtering.min_range == 2.0
    assert config.mapping.integrator == "rays"
    assert config.odometry.origin is not None
    assert config.odometry.origin.latitude == 53.5
    assert request.path_of(request.survey.dives[0]) == tmp_path / "a.mcap"


def test_the_arc_rule_is_refused(tmp_path: Path) -> None:
    reported = {"dives": DIVES, "settings": {"mapping": {"rule": "arc"}}}
    with pytest.raises(SurveyError, match=r"survey\.yaml: mapping\.rule arc .* allowed: iwlo"):
        read_survey(written(tmp_path, reported))


def test_a_dive_on_a_known_map_is_mapped_where_it_is_localized(tmp_path: Path) -> None:
    (tmp_path / "known.db").touch()
    request = read_survey(
        written(
            tmp_path, {"dives": [DIVES[0] | {"localization": "known.db"}, DIVES[0] | {"name": "b"}]}
        )
    )
    first, second = (request.config_of(dive).localization for dive in request.survey.dives)
    assert (first.mode, first.mapping) == ("track", "corrected")
    assert first.map_path == str(tmp_path / "known.db")
    assert (second.mode, second.mapping) == ("off", "odometry")


@pytest.mark.parametrize(
    ("reported", "stated"),
    [
        ("dives: [", "survey.yaml: line"),
        ({}, "missing required field `dives`"),
        ({"dives": []}, r"\$\.dives"),
        ({"dives": DIVES, "setings": {}}, "did you mean settings"),
        ({"dives": [DIVES[0] | {"name": "a/b"}]}, r"\$\.dives\[0\]\.name"),
        ({"dives": DIVES * 2}, "two dives are called a"),
        ({"dives": [DIVES[0] | {"transfrom": {}}]}, "did you mean transform"),
        ({"dives": [DIVES[0] | {"transform": {"roll": 1}}]}, "there is no roll; allowed: x, y, z"),
        ({"dives": [DIVES[0] | {"localization": "no.db"}]}, "there is no such map"),
        (
            {"dives": [DIVES[0] | {"odometry": ["no.csv"]}]},
            r"\$\.dives\[0\]\.odometry: no\.csv: there is no such file; allowed: a list",
        ),
        ({"dives": [DIVES[0] | {"odometry": "a.csv"}]}, "Expected `array`, got `str`"),
        (
            {"dives": [DIVES[0], {"name": "b", "recording": "no.mcap"}]},
            r"\$\.dives\[1\]\.recording: no\.mcap: there is no such recording; allowed: ",
        ),
        ({"dives": DIVES, "settings": {"octree": {"voxel": 1}}}, "there is no such setting"),
        ({"dives": DIVES, "settings": {"octree.voxel_resolution": -1}}, "-1 is not allowed"),
        ({"dives": DIVES, "configuration": "no.yaml"}, "no.yaml: cannot be read"),
        ({"dives": DIVES, "tile_size_m": 0}, "tile_size_m"),
        ({"dives": DIVES, "outputs": ["grids"]}, r"\$\.outputs: no such product: grids; allowed"),
        ({"dives": DIVES, "outputs": ["positions"]}, r"\$\.outputs: positions need an origin"),
        ({"dives": DIVES, "origin": {"latitude": 91, "longitude": 0}}, "origin.latitude"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line(
    tmp_path: Path, reported: object, stated: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, reported)
    with pytest.raises(SurveyError, match=stated):
        read_survey(path)
    code = main(["plan", str(path), "--out", str(tmp_path / "out"), "--workers", "0"])
    missing = re.search("no such (map|file|recording)", stated)
    assert code == (ExitCode.NO_INPUT if missing else ExitCode.BAD_CONFIG)
    error = capsys.readouterr().err
    assert error.startswith("mapper-survey: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_dive_has_one_place_alone(tmp_path: Path) -> None:
    (tmp_path / "known.db").touch()
    dive = DIVES[0] | {"localization": "known.db", "transform": {}}
    with pytest.raises(SurveyError, match="allowed: one of them"):
        read_survey(written(tmp_path, {"dives": [dive]}))


def test_a_transform_turns_then_shifts() -> None:
    matrix = DiveTransform(x=10.0, y=20.0, z=-1.0, yaw_deg=90.0).matrix()
    np.testing.assert_allclose(matrix @ [1.0, 0.0, 2.0, 1.0], [10.0, 21.0, 1.0, 1.0], atol=1e-12)


def test_memory_chooses_the_tile(tmp_path: Path) -> None:
    config = read_survey(written(tmp_path, {"dives": DIVES})).config
    resolution_m = config.octree.voxel_resolution
    assert [bytes_of(text) for text in ("2GB", "1.5 GiB", "700", "3kB")] == [
        2 * 10**9,
        3 << 29,
        700,
        3000,
    ]
    edges = [
        edge_for(config, voxel_bytes_of(size << 20, resolution_m), None) for size in (400, 16000)
    ]
    assert edges[0] < edges[1]
    assert edge_for(config, 10**9, 1e-3) == 1
    wanted: Any = 5 * 64 * resolution_m
    assert edge_for(config, 10**9, wanted) == 4
    with pytest.raises(SurveyError, match="MiB or more"):
        voxel_bytes_of(100 << 20, resolution_m)
    with pytest.raises(SurveyError, match="size of memory"):
        bytes_of("much")
