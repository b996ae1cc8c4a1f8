"""Errors that the user can correct, such as a wrong name or a missing map."""

__all__ = ["SurveyError"]


class SurveyError(Exception):
    """An error that the user can correct; its message is one line."""
