"""The command, on a fake study: what it prints, writes and draws."""

import re
import sys
from pathlib import Path

import pytest
from PIL import Image
from studies.accuracy_cost import command, drawing, running, study
from studies.accuracy_cost.command import main
from studies.accuracy_cost.results import read_results
from studies.accuracy_cost.study import Study

MARK = "<!-- fake: begin, written by hand -->"
PAGE = f"# A page\n\n{MARK}\nold\n<!-- fake: end -->\n\nThe end.\n"


@pytest.fixture
def recorded(fake: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of what is committed, and a page beside it."""
    assert fake.name in study.MODULES
    monkeypatch.setattr(command, "MODULES", study.MODULES)
    monkeypatch.setattr(running, "commit", lambda: "abc")
    monkeypatch.setattr(command, "RECORDED", tmp_path / "docs")
    monkeypatch.setattr(drawing, "PAGE", tmp_path / "page.md")
    (tmp_path / "page.md").write_text(PAGE)
    return tmp_path / "docs"


def accuracy_cost(folder: Path, *words: str) -> int:
    out = () if words[0] == "check" else ("--out", str(folder / "out"))
    pictures = ("--pictures", str(folder / "pictures")) if words[0] == "plot" else ()
    return main([*words, *out, *pictures])


@pytest.mark.slow
def test_run_plot_and_check_make_everything(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy_cost(tmp_path, "run", "--jobs", "1", "--write") == 0
    assert "16 measurements, 0 were there" in capsys.readouterr().out
    file = read_results(recorded / "fake.csv")
    assert len(file.rows) == 16
    assert file.head["commit"] == "abc"

    assert accuracy_cost(tmp_path, "plot", "--write") == 0
    pictures = sorted((tmp_path / "pictures").iterdir())
    assert [p.name for p in pictures] == ["fake-size.png", "fake-way.png", "fake.png"]
    for picture in pictures:
        assert picture.stat().st_size < 80_000
        with Image.open(picture) as image:
            assert len(image.convert("RGB").getcolors(65536) or ()) > 5
    page = (tmp_path / "page.md").read_text()
    assert "\nold\n" not in page
    assert "| | default | published |" in page
    assert "| error, m | 1.5 | 2.25 |" in page
    assert "| CPU, ms | 10 | 100 |" in page
    assert "1: 1.5 at 10 | 2: 3.3 at 2.5 | 0.5: 0.75 at 40 | 2: 3.3 at 2.5 | yes |" in page
    assert "10 % behind good" in page

    assert accuracy_cost(tmp_path, "check") == 0
    assert capsys.readouterr().out.endswith("fake: size: the default is on the front\n")
    sys.modules["fake_study"].FIGURES["size=2"] = (2.5, 0.85)
    assert accuracy_cost(tmp_path, "check") == 1
    assert "fake: size: the default lies 15.0 % behind" in capsys.readouterr().err


def test_a_part_is_never_recorded_as_the_whole(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy_cost(tmp_path, "run", "--jobs", "1", "--knob", "size", "--write") == 2
    assert "fake: 8 of 16 " in capsys.readouterr().err
    assert not recorded.exists()


def test_a_failed_measurement_is_reported_by_the_exit_code(
    recorded: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("FAKE_2", "raises")
    assert accuracy_cost(tmp_path, "run", "--quick", "--jobs", "1", "--write") == 1
    assert "4 measurements, 0 were there, 1 failed" in capsys.readouterr().out
    assert not recorded.exists()
    assert accuracy_cost(tmp_path, "plot", "--knob", "size") == 0
    assert [p.name for p in (tmp_path / "pictures").iterdir()] == ["fake-size.png"]


@pytest.mark.usefixtures("recorded")
def test_an_unknown_knob_is_named_with_those_that_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy_cost(tmp_path, "run", "--knob", "colour") == 2
    assert re.fullmatch("accuracy-cost: .*colour.* size, way\n", capsys.readouterr().err)


@pytest.mark.usefixtures("recorded")
def test_an_interrupt_reports_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run", interrupted)
    assert accuracy_cost(tmp_path, "run") == 130
    assert capsys.readouterr().err


@pytest.mark.usefixtures("recorded")
def test_nothing_to_draw_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert accuracy_cost(tmp_path, "plot") == 2
    assert re.fullmatch("accuracy-cost: fake: .*accuracy-cost run\n", capsys.readouterr().err)
