"""A survey's folder that cannot be written into is told, and nothing else is told as that."""

import errno
from pathlib import Path

import pytest
from mapper_survey.errors import SurveyError

from tests.tools.mapper_survey.dives import run_here, write_survey


def refused(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, "Permission denied", "a.mcap")


@pytest.mark.parametrize(
    ("what", "error", "said"),
    [
        ("pathlib.Path.mkdir", SurveyError, "out: cannot be written into: Permission denied"),
        ("mapper_survey.running.plan_all", PermissionError, "Permission denied: 'a.mcap'"),
    ],
)
def test_only_the_folder_is_said_not_to_be_written_into(
    tmp_path: Path, what: str, error: type[Exception], said: str
) -> None:
    survey = write_survey(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what, refused)
        with pytest.raises(error, match=said):
            run_here(survey, tmp_path / "out")
