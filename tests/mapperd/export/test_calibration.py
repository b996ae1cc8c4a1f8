"""Calibrated probabilities in exports: the curve, its file, and who it is refused to."""

from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData

from mapperd.errors import ConfigError, ExportError
from mapperd.export.calibration import ProbabilityCalibration, load_calibration
from mapperd.export.formats import FORMATS, PROBABILITY_FORMATS, write_map
from tests.support.mapperctl import Call, call
from tests.support.maps import FREE, OCCUPIED, map_of

__all__ = ["call"]

HALVED = ProbabilityCalibration(np.array([-4.0, 0.0, 4.0]), np.array([-2.0, 0.0, 2.0]))
TEXT = "log_odds: [-4.0, 0.0, 4.0]\ncalibrated: [-2.0, 0.0, 2.0]\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "curve.yaml"
    path.write_text(text)
    return path


def test_straight_between_points_and_level_beyond() -> None:
    reported = HALVED.log_odds_of(np.array([-100.0, -4.0, -1.0, 0.0, 3.0, 4.0, 50.0]))
    assert reported == pytest.approx([-2.0, -2.0, -0.5, 0.0, 1.5, 2.0, 2.0])


def test_probabilities_go_through_log_odds_and_certainty_is_no_trouble() -> None:
    reported = HALVED.probability_of(np.array([0.0, 0.5, 0.9, 1.0]))
    nine = 1 / (1 + 9**-0.5)  # odds of 9 become odds of 3
    assert reported == pytest.approx([1 / (1 + np.exp(2.0)), 0.5, nine, 1 / (1 + np.exp(-2.0))])


def test_more_stays_more() -> None:
    level = ProbabilityCalibration(np.array([-1.0, 0.0, 1.0]), np.array([-1.0, 0.5, 0.5]))
    reported = level.probability_of(np.linspace(0.0, 1.0, 201))
    assert (np.diff(reported) >= 0).all()


def test_only_numbers_change_in_a_file(tmp_path: Path) -> None:
    sonar_map = map_of(OCCUPIED, FREE)
    before = sonar_map.sha256()
    write_map(sonar_map, tmp_path / "raw.ply")
    write_map(sonar_map, tmp_path / "calibrated.ply", calibration=HALVED)
    raw, reported = (
        PlyData.read(str(tmp_path / f"{n}.ply"))["vertex"] for n in ("raw", "calibrated")
    )
    for name in ("x", "y", "z", "count"):
        assert np.array_equal(raw[name], reported[name])
    assert reported["probability"] == pytest.approx(1 / (1 + np.exp(-1.5)), abs=1e-6)
    assert raw["probability"] == pytest.approx(1 / (1 + np.exp(-3.0)), abs=1e-6)
    assert sonar_map.sha256() == before


@pytest.mark.parametrize("suffix", PROBABILITY_FORMATS)
def test_every_format_that_reports_probabilities_takes_it(tmp_path: Path, suffix: str) -> None:
    sonar_map = map_of(OCCUPIED, FREE)
    files = [tmp_path / f"{name}{suffix}" for name in ("raw", "calibrated")]
    write_map(sonar_map, files[0])
    write_map(sonar_map, files[1], calibration=HALVED)
    assert files[0].read_bytes() != files[1].read_bytes()


@pytest.mark.parametrize("suffix", sorted(set(FORMATS) - set(PROBABILITY_FORMATS)))
def test_the_others_refuse_it(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(ExportError, match=f"{suffix} takes no calibration"):
        write_map(map_of(OCCUPIED, FREE), tmp_path / f"a{suffix}", calibration=HALVED)
    assert list(tmp_path.iterdir()) == []


def test_file_is_read(tmp_path: Path) -> None:
    read = load_calibration(written(tmp_path, TEXT))
    assert np.array_equal(read.log_odds, HALVED.log_odds)
    assert np.array_equal(read.calibrated, HALVED.calibrated)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TEXT.replace("-4.0, 0.0", "0.0, 0.0"), "log_odds must rise"),
        (TEXT.replace("-2.0, 0.0", "1.0, 0.0"), "must not fall"),
        (TEXT.replace(", 4.0]", "]"), "2 log_odds and 3 calibrated"),
        (TEXT.replace("4.0]", ".nan]"), "within"),
        (TEXT.replace("4.0]", ".inf]"), "within"),
        ("log_odds: []\ncalibrated: []\n", "at least one"),
        ("log_odds: [1.0]\n", "calibrated"),
        (TEXT + "more: 1\n", "more"),
        ("- 1\n", "object"),
        ("log_odds: &a [1.0]\ncalibrated: *a\n", "aliases"),
        ("\xff", "utf-8"),
    ],
)
def test_what_is_no_curve_is_refused_in_one_line(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "curve.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ConfigError, match=reason) as caught:
        load_calibration(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_no_file_and_a_large_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_calibration(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="larger than"):
        load_calibration(written(tmp_path, "#" * 70_000))


def test_convert_applies_it_and_refuses_it_before_any_work(tmp_path: Path, call: Call) -> None:
    map_of(OCCUPIED, FREE).save(tmp_path / "a.map")
    curve = written(tmp_path, TEXT)
    words = ("convert", tmp_path / "a.map")
    assert call(*words, tmp_path / "a.ply", "--calibration", curve)[0] == 0
    reported = PlyData.read(str(tmp_path / "a.ply"))["vertex"]["probability"]
    assert reported == pytest.approx(1 / (1 + np.exp(-1.5)), abs=1e-6)
    code, lines, error = call(*words, tmp_path / "a.xyz", "--calibration", curve)
    assert (code, lines) == (73, [])
    assert "takes no calibration" in error
