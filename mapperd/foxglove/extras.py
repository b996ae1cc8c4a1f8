"""Libraries that not everybody has."""

__all__ = ["foxglove_missing"]


def foxglove_missing(error: ModuleNotFoundError) -> str:
    """For a person: what to install; any other module that is missing is a fault of ours.

    Raises:
        ModuleNotFoundError: it is another one.
    """
    if (error.name or "").partition(".")[0] != "foxglove":
        raise error
    return "this needs foxglove-sdk: pip install 'mapperd[foxglove]'"
