"""What a person can mend: a wrong name, a map that is not there, two that do not fit."""

__all__ = ["SurveyError"]


class SurveyError(Exception):
    """An error that the user can correct; its message is one line."""
