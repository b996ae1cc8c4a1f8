"""`mapper-survey align`: what it reads, what it passes on, and the survey that it writes."""

import os
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mapper_survey import main
from mapper_survey.command import _parser
from mapper_survey.request import read_survey

from mapperd.alignment.align import AlignedDive, Alignment, DiveInput
from mapperd.alignment.submaps import compose
from oculus_driver.command_line import ExitCode
from tests.support.shell_blocks import blocks_of
from tests.tools.mapper_survey.dives import SETTINGS, run_here, write_dive, write_survey

GUIDE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "align.md"

Capture = pytest.CaptureFixture[str]


class Aligner:
    """Takes the place of the alignment: dives lie where their frame puts them, or at zero."""

    def __init__(self) -> None:
        self.corrected = True
        self.given: list[DiveInput] = []

    def __call__(
        self, dives: Sequence[DiveInput], _: object, progress: Callable[[float, str], None]
    ) -> Alignment:
        self.given = list(dives)
        aligned = []
        for given in dives:
            track = given.read(None).track
            t_ns = track.t_ns[[0, -1]]
            odometry = track.at(t_ns)
            frame = np.zeros(3) if given.frame is None else given.frame
            covariance = np.stack([np.diag([0.03**2, 0.04**2, 1e-4])] * 2)
            drift = np.zeros((2, 3))
            aligned.append(
                AlignedDive(
                    given.name,
                    t_ns,
                    odometry,
                    compose(frame[None], odometry),
                    covariance,
                    drift,
                    frame,
                    track,
                )
            )
        progress(1.0, "done")
        reason = "" if self.corrected else "b could not be registered to the others"
        return Alignment(aligned, [], self.corrected, reason, 0)


@pytest.fixture
def aligner(monkeypatch: pytest.MonkeyPatch) -> Aligner:
    found = Aligner()
    monkeypatch.setattr("mapperd.alignment.align.align", found)
    monkeypatch.setattr("mapperd.alignment.report._draw", lambda *_: [])
    return found


def written(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load((folder / "survey.yaml").read_text("utf-8"))
    return content


def test_a_transform_is_a_known_frame_and_heights_are_its_own(
    tmp_path: Path, aligner: Aligner
) -> None:
    survey = write_survey(tmp_path, tile_size_m=25.6)
    out = tmp_path / "deep" / "aligned"
    assert main(["align", str(survey), "--out", str(out)]) == ExitCode.OK
    first, second = aligner.given
    assert first.frame is None
    assert second.frame == pytest.approx([14.0, -9.0, np.radians(70.0)])
    rows = [np.loadtxt(out / f"{name}.tum") for name in ("a", "b")]
    assert rows[0][:, 3] == pytest.approx(-3.0)
    assert rows[1][:, 3] == pytest.approx(-2.7)
    assert written(out) == {
        "settings": SETTINGS,
        "tile_size_m": 25.6,
        "dives": [
            {
                "name": "a",
                "recording": os.path.relpath(tmp_path / "a.mcap", out),
                "odometry": ["a.mcap"],
            },
            {
                "name": "b",
                "recording": os.path.relpath(tmp_path / "b.mcap", out),
                "odometry": ["b.mcap"],
            },
        ],
    }
    read_survey(out / "survey.yaml")


def test_a_survey_with_an_origin_shares_its_frame(tmp_path: Path, aligner: Aligner) -> None:
    origin = {"latitude": 54.0, "longitude": 10.0}
    survey = write_survey(tmp_path, dives=[{"name": "a", "recording": "a.mcap"}], origin=origin)
    assert main(["align", str(survey), "--out", str(tmp_path / "out")]) == ExitCode.OK
    assert aligner.given[0].frame == pytest.approx([0, 0, 0])
    assert written(tmp_path / "out")["origin"]["latitude"] == 54.0


def test_fixes_place_a_dive_in_place_of_the_origin(tmp_path: Path, aligner: Aligner) -> None:
    (tmp_path / "gps.csv").write_text("time_s,latitude_deg,longitude_deg\n7,54,10\n")
    survey = write_survey(
        tmp_path,
        dives=[{"name": "a", "recording": "a.mcap", "fixes": "gps.csv"}],
        origin={"latitude": 54.0, "longitude": 10.0},
    )
    assert main(["align", str(survey), "--out", str(tmp_path / "out")]) == ExitCode.OK
    [given] = aligner.given
    assert given.frame is None
    [(t_ns, x_m, y_m, _)] = given.fixes
    assert t_ns == 7_000_000_000
    assert (x_m, y_m) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_file_of_fixes_that_is_wrong_is_one_line(
    tmp_path: Path, aligner: Aligner, capsys: Capture
) -> None:
    (tmp_path / "gps.csv").write_text("time_s,x_m\n7,54\n")
    dive = {"name": "a", "recording": "a.mcap", "fixes": "gps.csv"}
    survey = write_survey(tmp_path, dives=[dive])
    assert main(["align", str(survey), "--out", str(tmp_path / "out")]) != ExitCode.OK
    assert "gps.csv" in capsys.readouterr().err.splitlines()[-1]
    assert not aligner.given


def test_a_refused_alignment_has_a_code_a_verdict_and_no_survey(
    tmp_path: Path, aligner: Aligner, capsys: Capture
) -> None:
    survey, out = write_survey(tmp_path), tmp_path / "out"
    assert main(["align", str(survey), "--out", str(out)]) == ExitCode.OK
    aligner.corrected = False
    assert main(["align", str(survey), "--out", str(out)]) == ExitCode.NOT_ALL
    assert "not corrected, because b could not be registered" in capsys.readouterr().out
    assert not (out / "survey.yaml").exists()
    assert (out / "report.md").exists()


def test_recordings_become_dives_with_the_given_settings_and_odometry(
    tmp_path: Path, aligner: Aligner
) -> None:
    for folder, y in (("one", 0.0), ("two", 4.0)):
        write_dive(tmp_path / folder / "dive.mcap", 1, y=y)
    config = tmp_path / "vehicle.yaml"
    config.write_text(yaml.safe_dump(SETTINGS))
    paths = [str(tmp_path / folder / "dive.mcap") for folder in ("one", "two")]
    out = tmp_path / "out"
    words = ["align", *paths, "--odometry", *reversed(paths), "--config", str(config)]
    assert main([*words, "--out", str(out)]) == ExitCode.OK
    assert [dive.name for dive in aligner.given] == ["dive-1", "dive-2"]
    north = [np.loadtxt(out / f"dive-{k}.tum")[0, 2] for k in (1, 2)]
    assert north == pytest.approx([4.0, 0.0])
    assert written(out)["configuration"] == "../vehicle.yaml"


@pytest.mark.slow
def test_the_survey_written_maps_at_the_aligned_poses_and_keeps_their_deviation(
    tmp_path: Path, aligner: Aligner
) -> None:
    survey, out = write_survey(tmp_path), tmp_path / "out"
    assert main(["align", str(survey), "--out", str(out), "--threads", "1"]) == ExitCode.OK
    assert len(aligner.given) == 2
    record = run_here(out / "survey.yaml", tmp_path / "run")
    for dive in record["dives"]:
        assert dive["pings"] > 20
        assert dive["deviation_mean_m"] == pytest.approx(0.05, abs=1e-3)
        assert dive["deviation_max_m"] == pytest.approx(0.05, abs=1e-3)


@pytest.fixture
def files_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_survey(tmp_path)
    (tmp_path / "text.mcap").write_text("no recording\n")
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("files_here")
@pytest.mark.parametrize(
    ("words", "code", "named"),
    [
        (["none.mcap"], ExitCode.NO_INPUT, "none.mcap"),
        (["none.yaml"], ExitCode.NO_INPUT, "none.yaml"),
        (["survey.yaml", "--config", "c.yaml"], ExitCode.USAGE, "--config"),
        (["a.mcap", "--odometry", "a.mcap", "b.mcap"], ExitCode.USAGE, "--odometry"),
        (["text.mcap"], ExitCode.BAD_DATA, "text"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str],
    code: ExitCode,
    named: str,
    capsys: Capture,
) -> None:
    assert main(["align", *words, "--out", "out"]) == code
    [line] = capsys.readouterr().err.splitlines()
    assert named in line


def test_a_localized_dive_is_refused(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "known.map").touch()
    dive = {"name": "a", "recording": "a.mcap", "localization": "known.map"}
    survey = write_survey(tmp_path, dives=[dive])
    code = main(["align", str(survey), "--out", str(tmp_path / "out")])
    assert code == ExitCode.BAD_CONFIG
    assert "localization" in capsys.readouterr().err


def test_commands_of_the_guide_are_understood() -> None:
    """Of align.md: dives that align take minutes to simulate."""
    lines = [
        shlex.split(line)
        for block in blocks_of(GUIDE)
        for line in block.code.splitlines()
        if line.startswith("mapper-survey")
    ]
    assert len(lines) == 3
    for words in lines:
        assert _parser().parse_args(words[1:]).out == (
            Path("aligned") if words[1] == "align" else "survey-2026"
        )
