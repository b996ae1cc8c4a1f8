"""The sub-commands export and report, as a person gives them."""

import argparse
import json
import re
from pathlib import Path

import fsspec
import msgspec
import numpy as np
import pytest
import rasterio
from mapper_survey.arguments import _origin, progress_lines
from mapper_survey.command import main
from mapper_survey.errors import SurveyError
from mapper_survey.request import read_survey

from mapperd.config.live import with_values
from mapperd.config.tree import Config
from mapperd.geometry.geodesy import Origin as GeodeticOrigin
from tests.tools.mapper_survey.maps import map_of, store_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A survey of two dives over a small floor, the second higher and farther east."""
    (tmp_path / "dives").mkdir()
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(8), np.arange(8)))
    floor = np.stack([x, y, np.full(64, -30)], axis=1)
    dives = {"one": map_of(floor), "two": map_of(floor + np.array([3, 0, 3]), free=floor)}
    for name, one in dives.items():
        store_of(tmp_path / "dives" / f"{name}.db", one)
    store_of(tmp_path / "map.db", dives["one"])
    return tmp_path


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_export_writes_what_can_be(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("export", folder) == 0
    written = {path.name for path in (folder / "exports").iterdir()}
    assert written == {"depth.tif", "cloud.laz", "soundings.xyz"}
    assert "depth.tif" in capsys.readouterr().out


def test_export_does_what_it_is_reported(folder: Path, tmp_path: Path) -> None:
    settings = tmp_path / "strict.yaml"
    settings.write_text("mapping: {occupied_threshold: 0.9}\n")
    words = ["--origin=54.36,10.16", "--out", tmp_path / "here", "--cell-voxels", 4]
    words += ["--altitude", 1, "--max-z=-2.8", "--rule", "median", "--vertical-uncertainty", 0.4]
    assert run("export", folder, *words, "--config", settings) == 0
    with rasterio.open(tmp_path / "here/depth.tif") as grid:
        assert grid.crs is not None
        assert grid.res == pytest.approx((0.4, 0.4))
        depths, uncertainty, _ = grid.read(masked=True)
        assert depths.min() == depths.max() == pytest.approx(2.95 - 1)
        assert uncertainty.min() > 0.4
    assert len((tmp_path / "here/positions.xyz").read_text().split("\n")) == depths.count() + 1
    settings.write_text("mapping: {occupied_threshold: 0.99}\n")
    assert run("export", folder, "--config", settings) != 0


@pytest.mark.slow
def test_report_reports_how_the_dives_agree(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("report", folder, "--tolerance", 0.2) == 0
    reported = capsys.readouterr().out
    assert re.search(r"one, two: 100\.0% .*0\.2 m \(poor\); 64 conflicts", reported)
    assert (folder / "report" / "report.json").exists()


@pytest.mark.parametrize(
    ("command", "words", "stated"),
    [
        ("export", ["--products", "positions"], "positions need an origin"),
        ("report", ["--tolerance", "0"], "tolerance: 0 m is not allowed"),
        ("report", ["--config", "gone.yaml"], "gone.yaml"),
    ],
)
def test_what_a_person_can_mend_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], command: str, words: list[str], stated: str
) -> None:
    assert run(command, folder, *words) == (78 if "--config" in words else 2)
    reported = capsys.readouterr().err
    assert stated in reported
    assert reported.count("\n") == 1


def test_survey_that_was_not_run_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("export", "report"):
        assert run(command, tmp_path) == 66
        assert "map.db" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    store_of(tmp_path / "map.db", map_of(np.array([[0, 0, 0]])))
    assert run("report", tmp_path) == 2
    assert "--dives" in capsys.readouterr().err


@pytest.mark.slow
def test_what_the_survey_reports_of_itself_need_not_be_reported_again(folder: Path) -> None:
    record = {
        "origin": {"latitude": 54.36, "longitude": 10.16, "altitude": 0.5},
        "settings": msgspec.to_builtins(
            with_values(
                Config(), {"mapping.occupied_threshold": 0.9, "mapping.free_threshold": 0.2}
            )
        ),
        "outputs": ["grid", "positions"],
    }
    (folder / "survey.json").write_text(json.dumps(record))
    assert run("export", folder) == 0
    written = folder / "exports"
    assert {path.name for path in written.iterdir()} == {"depth.tif", "positions.xyz"}
    longitude, latitude, depth = np.loadtxt(written / "positions.xyz").T
    assert longitude == pytest.approx(10.16, abs=1e-4)
    assert latitude == pytest.approx(54.36, abs=1e-4)
    assert depth == pytest.approx(2.95 - 0.5)
    words = ["--altitude", 1, "--origin=-10,20", "--products", "positions"]
    assert run("export", folder, *words) == 0
    assert np.loadtxt(written / "positions.xyz").mean(axis=0) == pytest.approx(
        [20, -10, 1.95], abs=1e-4
    )
    assert run("report", folder) == 0
    report = json.loads((folder / "report/report.json").read_text())
    assert (report["occupied_threshold"], report["free_threshold"]) == (0.9, 0.2)
    with rasterio.open(folder / "report/difference.tif") as grid:
        assert grid.crs is not None


def test_damaged_record_is_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "survey.json").write_text('{"origin": 3}')
    assert run("export", folder) == 2
    assert "survey.json: " in capsys.readouterr().err


@pytest.mark.slow
def test_folder_elsewhere_is_read_from_there(folder: Path, tmp_path: Path) -> None:
    elsewhere = fsspec.filesystem("memory")
    elsewhere.put(f"{folder}/", "memory://commands", recursive=True)
    assert run("export", "memory://commands") == 2
    words = ["--products", "grid", "soundings"]
    assert run("export", "memory://commands", *words, "--out", tmp_path / "here") == 0
    assert run("export", folder, *words) == 0
    for name in ("depth.tif", "soundings.xyz"):
        here = (folder / "exports" / name).read_bytes()
        assert (tmp_path / "here" / name).read_bytes() == here
    assert run("report", "memory://commands", "--out", tmp_path / "here") == 0
    report = json.loads((tmp_path / "here/report.json").read_text())
    assert [dive["name"] for dive in report["dives"]] == ["one", "two"]


def test_place_that_is_invalid_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run("export", folder, "--origin=91,0")
    assert "latitude,longitude" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("90,180", True),
        ("-90,-180", True),
        ("90.1,0", False),
        ("0,180.1", False),
        ("nan,0", False),
        ("0,nan", False),
    ],
)
def test_one_rule_for_an_origin(text: str, allowed: bool, tmp_path: Path) -> None:  # noqa: FBT001 parametrized
    latitude, longitude = text.replace("nan", ".nan").split(",")
    (tmp_path / "a.mcap").touch()
    survey = tmp_path / "survey.yaml"
    origin = f"origin: {{latitude: {latitude}, longitude: {longitude}}}"
    survey.write_text(f"dives: [{{name: a, recording: a.mcap}}]\n{origin}\n", encoding="utf-8")
    if not allowed:
        with pytest.raises(argparse.ArgumentTypeError, match="were expected"):
            _origin(text)
        with pytest.raises(SurveyError, match=r"survey\.yaml: "):
            read_survey(survey)
        return
    known = read_survey(survey).survey.origin
    assert known is not None
    assert _origin(text) == GeodeticOrigin.of_degrees(known.latitude, known.longitude)


def test_progress_reports_the_time_that_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    times = iter([0.0, 1.0, 10.0, 11.0])
    show = progress_lines("export", lambda: next(times))
    for done in (1, 5, 6):
        show(done, 20)
    assert capsys.readouterr().err == "export: 25 %, 30 s left\n"
