"""Two runs in one folder, where no disk's lock reaches."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mapper_survey.command import main
from mapper_survey.engine import InProcess
from mapper_survey.errors import SurveyError
from mapper_survey.folder import LOCK, Folder, Holder, held, this_system
from mapper_survey.request import read_survey
from mapper_survey.running import RunOptions, run_survey

from tests.tools.mapper_survey.dives import MEMORY, Silent, write_survey


@pytest.fixture
def elsewhere(tmp_path: Path) -> Folder:
    return Folder(f"memory://{tmp_path.name}")


def holder(folder: Folder, **changes: Any) -> Holder:
    """Put one there."""
    mine = Holder("near", this_system(), 1, "a")
    stated = msgspec.structs.replace(mine, **changes)
    folder.write(LOCK, msgspec.json.encode(stated))
    return stated


def test_a_second_run_is_refused(
    elsewhere: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = write_survey(tmp_path, dives=[{"name": "a", "recording": "a.mcap"}])
    words = ["run", str(survey), "--out", elsewhere.url, "--workers", "0"]
    with held(elsewhere):
        assert main(words) == 2
    reported = capsys.readouterr().err
    assert "another mapper-survey is at work" in reported
    assert f"remove {elsewhere.url}/{LOCK}" in reported
    assert not elsewhere.has("map.db")
    assert main(words) == 0
    assert elsewhere.has("map.db")
    assert not elsewhere.has(LOCK)


def test_an_error_leaves_no_lock(elsewhere: Folder, tmp_path: Path) -> None:
    survey = write_survey(tmp_path, dives=[{"name": "a", "recording": "nowhere.mcap"}])
    with pytest.raises(SurveyError, match="no such recording"):
        run_survey(
            read_survey(survey),
            elsewhere,
            InProcess(),
            RunOptions(MEMORY),
            Silent(),  # type: ignore[arg-type]
        )
    assert not elsewhere.has(LOCK)


def test_who_was_killed_on_this_machine_holds_nothing(elsewhere: Folder) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    holder(elsewhere, pid=process.pid)
    with held(elsewhere):
        pass
    assert not elsewhere.has(LOCK)


@pytest.mark.parametrize("system", ["another machine", ""])
def test_of_other_machines_nobody_knows(elsewhere: Folder, system: str) -> None:
    gone = holder(elsewhere, system=system, pid=2**30)
    with pytest.raises(SurveyError, match="process 1073741824 of near"), held(elsewhere):
        pass
    assert msgspec.json.decode(elsewhere.read(LOCK) or b"", type=Holder) == gone


def test_a_lock_that_nobody_can_read_is_one(elsewhere: Folder) -> None:
    elsewhere.write(LOCK, b"{")
    with pytest.raises(SurveyError, match="of an unknown machine"), held(elsewhere):
        pass


def test_anyone_who_wrote_last_has_it(elsewhere: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both saw no lock and wrote one."""
    write = Folder.write

    def overtaken(self: Folder, name: str, data: bytes) -> None:
        write(self, name, data)
        other = Holder("near", this_system(), 1, "other")
        write(self, name, msgspec.json.encode(other))

    monkeypatch.setattr(Folder, "write", overtaken)
    with pytest.raises(SurveyError, match="another mapper-survey"), held(elsewhere):
        pass
    assert elsewhere.has(LOCK)
