"""Which version of the package runs."""

import importlib.metadata

__all__ = ["version"]


def version() -> str:
    """The installed version, "unknown" where the package runs without being installed."""
    try:
        return importlib.metadata.version("mapperd")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
