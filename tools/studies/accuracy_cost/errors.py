"""What a person can mend: a wrong name, a file that is missing, two runs at once."""

__all__ = ["AccuracyCostError"]


class AccuracyCostError(Exception):
    """Told in one line."""
