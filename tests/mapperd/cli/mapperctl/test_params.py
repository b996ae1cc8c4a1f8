import json
import subprocess
import sys
from pathlib import Path

import pytest

from mapperd.cli.mapperctl.command import main
from mapperd.config.catalog import parameters


@pytest.fixture
def low(tmp_path: Path) -> Path:
    path = tmp_path / "low.yaml"
    path.write_text("octree: {voxel_resolution: 0.2}\nfiltering: {min_range: 1}", encoding="utf-8")
    return path


@pytest.fixture
def high(tmp_path: Path) -> Path:
    path = tmp_path / "high.yaml"
    path.write_text("octree: {voxel_resolution: 0.3}", encoding="utf-8")
    return path


def test_all_settings_are_reported_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(" = ")[0] for line in lines] == list(parameters())
    assert "octree.voxel_resolution = 0.05 m" in lines
    assert 'mapping.integrator = "evidence_grid"' in lines
    assert "crosstalk.azimuth_threshold = 0.5" in lines
    assert "odometry.origin = null" in lines


def test_origin_is_the_last_file_that_reports_it(
    low: Path, high: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAPPERD_CONFIG", str(low))
    names = ["octree.voxel_resolution", "filtering"]
    assert main(["params", *names, "--origin", "--config", str(high)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"filtering.min_range = 1.0 m  # {low}",
        "filtering.intensity_threshold = 35.0  # default",
        "filtering.noise_factor = 0.0  # default",
        f"octree.voxel_resolution = 0.3 m  # {high}",
    ]


def test_later_config_lies_on_top(
    low: Path, high: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["params", "octree.voxel_resolution", "--config", str(high), "--config", str(low)])
    assert capsys.readouterr().out == "octree.voxel_resolution = 0.2 m\n"


def test_json_reports_everything(low: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["params", "--json", "--config", str(low)]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert list(reported) == list(parameters())
    assert reported["octree.voxel_resolution"] == {
        "value": 0.2,
        "default": 0.05,
        "unit": "m",
        "allowed": "a number >= 0.001 and <= 100 (m)",
        "dynamic": False,
        "origin": str(low),
        "description": parameters()["octree.voxel_resolution"].description,
    }


def test_wrong_settings_are_one_line_and_exit_78(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("octree: {voxel_resolution: 0}", encoding="utf-8")
    assert main(["params", "--config", str(path)]) == 78
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"mapperctl: {path}: $.octree.voxel_resolution: 0 ")
    assert output.err.count("\n") == 1


def test_unknown_name_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["params", "octre"])
    assert caught.value.code == 2
    assert "'octre'" in capsys.readouterr().err


def test_reader_that_leaves_is_no_fault() -> None:
    code = (
        "import sys; from mapperd.cli.mapperctl.command import main; "
        "sys.exit(main(['params', '--json']))"
    )
    with subprocess.Popen(  # noqa: S603 our own line
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
        assert process.wait(timeout=60) == 0
