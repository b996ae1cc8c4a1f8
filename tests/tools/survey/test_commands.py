"""The sub-commands export and report, as a person gives them."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from survey import export_command, report_command
from survey.place_arguments import shown

from tests.tools.survey.maps import map_of, store_of


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


def run(command: Any, *words: object) -> int:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return int(command.run(parser.parse_args([str(word) for word in words])))


def test_export_writes_what_can_be(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(export_command, folder) == 0
    written = {path.name for path in (folder / "exports").iterdir()}
    assert written == {"depth.tif", "cloud.laz", "soundings.xyz"}
    assert "depth.tif" in capsys.readouterr().out


def test_export_does_what_it_is_told(folder: Path, tmp_path: Path) -> None:
    settings = tmp_path / "strict.yaml"
    settings.write_text("mapping: {occupied_threshold: 0.9}\n")
    words = ["--origin=54.36,10.16", "--out", tmp_path / "here", "--cell-voxels", 4]
    words += ["--altitude", 1, "--max-z=-2.8", "--rule", "median", "--vertical-uncertainty", 0.4]
    assert run(export_command, folder, *words, "--config", settings) == 0
    with rasterio.open(tmp_path / "here/depth.tif") as grid:
        assert grid.crs is not None
        assert grid.res == pytest.approx((0.4, 0.4))
        depths, uncertainty, _ = grid.read(masked=True)
        assert depths.min() == depths.max() == pytest.approx(2.95 - 1)
        assert uncertainty.min() > 0.4
    assert len((tmp_path / "here/positions.xyz").read_text().split("\n")) == depths.count() + 1
    settings.write_text("mapping: {occupied_threshold: 0.99}\n")
    assert run(export_command, folder, "--config", settings) == 2


def test_report_says_how_the_dives_agree(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(report_command, folder, "--tolerance", 0.2) == 0
    told = capsys.readouterr().out
    assert "one, two: 100.0% without a partner within 0.2 m (poor); 64 conflicts" in told
    assert (folder / "report" / "report.json").exists()


@pytest.mark.parametrize(
    ("command", "words", "said"),
    [
        (export_command, ["--products", "positions"], "positions need an origin"),
        (report_command, ["--tolerance", "0"], "tolerance: 0 m is not allowed"),
        (report_command, ["--config", "gone.yaml"], "gone.yaml"),
    ],
)
def test_what_a_person_can_mend_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], command: Any, words: list[str], said: str
) -> None:
    assert run(command, folder, *words) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1


def test_survey_that_was_not_run_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (export_command, report_command):
        assert run(command, tmp_path) == 2
    assert "run the survey first" in capsys.readouterr().err


def test_place_that_is_none_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        run(export_command, folder, "--origin=91,0")
    assert "latitude,longitude" in capsys.readouterr().err


def test_progress_says_the_time_that_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    times = iter([0.0, 1.0, 10.0, 11.0])
    show = shown("export", lambda: next(times))
    for done in (1, 5, 6):
        show(done, 20)
    assert capsys.readouterr().err == "export: 25 %, 30 s left\n"
