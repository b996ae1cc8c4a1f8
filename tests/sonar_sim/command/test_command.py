import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import sonar_sim.validation
from matplotlib.axes import Axes
from sonar_sim.command import main
from sonar_sim.scene_file import scene_names
from sonar_sim.validation.case import ValidationCheck, ValidationResult
from sonar_sim.validation.cases import CASES, draw_page


def test_list_names_every_scene(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "--names"]) == 0
    assert capsys.readouterr().out.split() == scene_names()


def test_list_reports_sonar_and_size(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sonar_sim.command.scene_list.scene_names", lambda: ["flat_floor"])
    assert main(["list"]) == 0
    assert "M750d mode 1" in capsys.readouterr().out


def test_render_writes_a_ping(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["render", "flat_floor", "--out", str(tmp_path), "--only", "polar,fan", "--height"]
    assert main([*argv, "200"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fan.png", "polar.npz", "polar.png"]
    assert "3 files" in capsys.readouterr().out
    fan = cv2.imread(str(tmp_path / "fan.png"))
    assert fan is not None
    assert fan.shape[0] == 200


@pytest.mark.slow
def test_several_pings_have_folders_of_their_own(tmp_path: Path) -> None:
    argv = ["render", "flat_floor", "--out", str(tmp_path), "--only", "polar", "--pings", "2"]
    assert main(argv) == 0
    first, second = (np.load(tmp_path / f"00000{k}" / "polar.npz") for k in (0, 1))
    assert first["time_s"] < second["time_s"]
    assert not np.array_equal(first["image"], second["image"])


@pytest.mark.slow
def test_equal_seeds_give_equal_pings(tmp_path: Path) -> None:
    images = []
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        argv = ["render", "flat_floor", "--out", str(tmp_path / name), "--only", "polar"]
        assert main([*argv, "--seed", seed, "--pose", "0,0,-3,0,60,0", "--range", "4"]) == 0
        images.append(np.load(tmp_path / name / "polar.npz")["image"])
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[2])


def test_classic_writes_what_the_plugin_published(tmp_path: Path) -> None:
    argv = ["render", "flat_floor", "--out", str(tmp_path), "--mode", "classic"]
    assert main([*argv, "--pose", "0,0,-4,0,10,0", "--camera", "512x114"]) == 0
    classic = np.load(tmp_path / "classic.npz")
    assert classic["raw_scan"].shape == (400, 578)
    assert classic["depth_m"].shape == (114, 512)
    assert (tmp_path / "points.ply").stat().st_size > 10_000


def test_classic_mode_honours_range_rows_products_and_camera(tmp_path: Path) -> None:
    argv = ["render", "flat_floor", "--mode", "classic", "--pose", "0,0,-4,0,10,0"]
    argv += ["--camera", "256x57", "--only", "image_depth_raw_sonar,depth"]
    scans = []
    for name, more in (("plain", []), ("fine", ["--scan-rows", "800"]), ("near", ["--range", "8"])):
        assert main([*argv, "--out", str(tmp_path / name), *more]) == 0
        found = sorted(path.name for path in (tmp_path / name).iterdir())
        assert found == ["classic.npz", "depth.png", "raw_scan.png"]
        arrays = np.load(tmp_path / name / "classic.npz")
        assert sorted(arrays) == ["depth_m", "raw_scan"]
        scans.append(arrays)
    plain, fine, near = scans
    assert plain["raw_scan"].shape == (400, 578)
    assert fine["raw_scan"].shape == (800, 1136)
    assert near["depth_m"].max() <= 8.0 < plain["depth_m"].max() <= 17.0
    middle = near["raw_scan"][:, 289] > 0.3  # above empty water
    assert middle.any()
    # The nearest echo lies higher in the picture, the shorter the range.
    assert np.flatnonzero(middle).max() < np.flatnonzero(plain["raw_scan"][:, 289] > 0.3).max()


@pytest.mark.parametrize(
    ("argv", "reason"),
    [
        (
            ["render", "flat_floor", "--out", "x", "--mode", "classic", "--only", "truth"],
            "classic mode has no product truth; it has depth",
        ),
        *(
            (
                ["render", "flat_floor", "--out", "x", "--mode", "classic", *option],
                f"{option[0]} has no effect in classic mode",
            )
            for option in (["--effects", "all"], ["--height", "300"], ["--colours", "inferno"])
        ),
        (["render", "nowhere", "--out", "x"], "no scene is named nowhere"),
        (["render", "flat_floor", "--out", "x", "--only", "fun"], "no product is called fun"),
        (["validate", "--out", "x", "--only", "V99"], "no case is named V99"),
        (["render", "flat_floor", "--out", "x", "--time", "nan"], "time nan s is not 0 to"),
        (["explain", "flat_floor", "--time", "1e9"], "time 1e+09 s is not 0 to"),
    ],
)
def test_what_cannot_be_is_one_line(
    argv: list[str],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(argv) == (66 if "no scene" in reason else 2)
    error = capsys.readouterr().err
    assert reason in error
    assert error.strip().count("sonar-sim:") == 1


@pytest.mark.parametrize(
    "option",
    [["--pose", "1,2,3"], ["--pose", "a,b,c,d,e,f"], ["--camera", "10"], ["--pings", "0"]],
)
def test_bad_values_are_refused_with_a_reason(
    option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["render", "flat_floor", "--out", "x", *option])
    assert stop.value.code == 2
    assert option[1] in capsys.readouterr().err


def _case(got: float) -> ValidationResult:
    return ValidationResult("V0 one", "us", (ValidationCheck("one", 1.0, got, 0.1),), _draw)


def _draw(axes: Axes) -> None:
    axes.plot([1.0, 0.0])


@pytest.mark.parametrize(("got", "code"), [(1.05, 0), (1.2, 1), (float("nan"), 1)])
def test_validate_fails_with_its_cases(
    got: float,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sonar_sim.command.validate.CASES", {"V0": lambda: _case(got)})
    assert main(["validate", "--out", str(tmp_path)]) == code
    assert ("OFF" in capsys.readouterr().out) == bool(code)
    assert (tmp_path / "simulator-validation.png").stat().st_size > 1000


def test_the_page_has_room_for_many_cases(tmp_path: Path) -> None:
    draw_page(tmp_path / "deep" / "page.png", [_case(1.0)] * 5)
    picture = cv2.imread(str(tmp_path / "deep" / "page.png"))
    assert picture is not None
    assert picture.shape[0] > 400


def test_cases_are_named_as_they_call_themselves() -> None:
    assert list(CASES) == sorted(CASES, key=lambda name: int(name[1:]))


def test_every_case_is_in_the_list() -> None:
    folder = Path(sonar_sim.validation.__file__).parent
    sources = [path.read_text(encoding="utf-8") for path in folder.glob("*.py")]
    functions = {
        name for text in sources for name in re.findall(r"^def (v\d+_\w+)", text, re.MULTILINE)
    }
    assert {case.__name__ for case in CASES.values()} == functions


@pytest.mark.parametrize(
    "argv",
    [
        ["explain", "flat_floor", "--tolerance-db", "0"],
        ["explain", "flat_floor", "--tolerance-cells", "nan"],
        ["render", "flat_floor", "--out", "x", "--camera", "100000x100000"],
        ["render", "flat_floor", "--out", "x", "--seed", "-1"],
        ["capture", "flat_floor", "--out", "x", "--seed", "-1"],
        ["serve", "flat_floor", "--seed", "-1"],
    ],
)
def test_a_value_that_cannot_be_is_refused(
    argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exited:
        main(argv)
    assert exited.value.code == 2
    assert argv[-2] in capsys.readouterr().err
