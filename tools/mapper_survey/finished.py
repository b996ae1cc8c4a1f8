"""A survey that was run: its folder, and what its `survey.json` says to what is made of it."""

import msgspec

from mapper_survey.errors import SurveyError
from mapper_survey.folder import Folder
from mapper_survey.request import Origin
from mapper_survey.running import RECORD, was_begun
from mapperd.config.tree import Config

__all__ = ["Told", "told_in"]


class Told(msgspec.Struct, frozen=True):
    """The part of `survey.json` that exports and the report go by.

    Attributes:
        origin: the survey's zero on Earth; None where nobody said.
        settings: that the map was made by; None where there is no record.
        outputs: products that the survey asks for; none are all that can be made.
    """

    origin: Origin | None = None
    settings: Config | None = None
    outputs: list[str] = []


def told_in(folder: Folder) -> Told:
    """What the record says; nothing where maps were put together without one.

    Raises:
        SurveyError: it is no such record, or a run has not come to its end.
    """
    data = folder.read(RECORD)
    if data is None:
        if was_begun(folder):
            raise SurveyError(
                f"{folder.url}: no {RECORD} in it: its run has not come to its end; "
                "the same mapper-survey run goes on"
            )
        return Told()
    try:
        return msgspec.json.decode(data, type=Told)
    except msgspec.DecodeError as error:
        raise SurveyError(
            f"{folder.url}/{RECORD}: no record of a survey ({error}): run the survey again"
        ) from error
