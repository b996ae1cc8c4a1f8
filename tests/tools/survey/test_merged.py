"""The merged map: how far it is, and whether what is there is still what was merged."""

import io
import re
from pathlib import Path

import pytest
from survey.engine import InProcess
from survey.folder import Folder
from survey.request import read_survey
from survey.running import Options, run_survey

from tests.tools.survey.dives import MEMORY, write_survey


class Terminal(io.StringIO):
    """Shows everything."""

    def isatty(self) -> bool:
        return True


def test_the_merge_says_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mapperd.progress.TTY_PERIOD_S", 0.0)
    survey, out = write_survey(tmp_path, tile_size_m=12.8), Terminal()
    folder = Folder(str(tmp_path / "out"))
    record = run_survey(read_survey(survey), folder, InProcess(), Options(MEMORY), out)
    tiles = record["maps"][0]["tiles"]
    shown = re.findall(r"([\d.]+) %  (\d+) shards  [\d.]+ shards/s", out.getvalue())
    expected = [(f"{100 * n / tiles:.1f}", str(n)) for n in range(1, tiles + 1)]
    assert tiles > 2
    assert shown == [*expected, expected[-1]]
