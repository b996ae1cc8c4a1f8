"""Errors that the user can correct, such as a wrong name or a missing map."""

__all__ = ["SurveyError", "SurveyMissingError", "SurveySettingsError"]


class SurveyError(Exception):
    """An error that the user can correct; its message is one line."""


class SurveyMissingError(SurveyError):
    """A file of a survey does not exist or cannot be read."""


class SurveySettingsError(SurveyError):
    """The file of a survey is invalid."""
