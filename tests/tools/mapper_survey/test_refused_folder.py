"""A survey folder that cannot be written is reported, and no other error is reported as that."""

import errno
from pathlib import Path

import pytest

from mapperd.errors import ExportError
from tests.tools.mapper_survey.dives import run_here, write_survey


def refused(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, "Permission denied", "a.mcap")


@pytest.mark.parametrize(
    ("what", "error", "stated"),
    [
        ("pathlib.Path.mkdir", ExportError, "out: cannot be written into: Permission denied"),
        ("mapper_survey.running.plan_all", PermissionError, "Permission denied: 'a.mcap'"),
    ],
)
def test_only_the_folder_is_reported_not_to_be_written_into(
    tmp_path: Path, what: str, error: type[Exception], stated: str
) -> None:
    survey = write_survey(tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what, refused)
        with pytest.raises(error, match=stated):
            run_here(survey, tmp_path / "out")
