"""`sonar-sim explain`, and the manual's table of effects."""

import json
from pathlib import Path

import pytest
from sonar_sim.command import main
from sonar_sim.effects.registry import EFFECTS, effects_markdown

MANUAL = Path(__file__).resolve().parents[3] / "docs" / "reference" / "simulator-effects.md"


@pytest.mark.slow
def test_explain_reports_every_effect(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "flat_floor", "--json", "--repeats", "1", "--time", "5"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["effect"] for row in rows] == list(EFFECTS)
    assert {tuple(row) for row in rows} == {("effect", "on", "reason", "predicted_db", "cost_ms")}
    on = {row["effect"]: row["on"] for row in rows}
    assert on["bottom_reverberation"]
    assert not on["multipath"]


@pytest.mark.slow
def test_explain_warns_of_what_is_switched_off(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["explain", "flat_floor", "--effects", "auto,-noise", "--repeats", "1"]
    assert main(arguments) == 0
    output = capsys.readouterr()
    assert "noise is switched off, but" in output.err
    assert "noise                  off" in output.out


def test_explain_refuses_unknown_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "flat_floor", "--effects", "auto,-nois"]) == 2
    assert "no effect 'nois'" in capsys.readouterr().err


def test_the_manual_has_the_modules_table() -> None:
    assert effects_markdown() in MANUAL.read_text(encoding="utf-8")
