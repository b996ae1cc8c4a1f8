"""A file whose structure is damaged makes room for a new one; nothing of it is deleted."""

from pathlib import Path

from mapperd.errors import StoreError

__all__ = ["put_aside"]

BESIDE = ("", "-wal", "-shm")
"""A file of SQLite and those that belong to it."""


def put_aside(path: Path) -> Path:
    """Rename a store that nobody has open; whoever can, maps its recordings into a new one.

    Returns:
        its new name.

    Raises:
        StoreError: it cannot be renamed.
    """
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    try:
        for suffix in reversed(BESIDE):  # the file itself last: until then it is found as damaged
            beside = path.with_name(path.name + suffix)
            if beside.exists():
                beside.rename(aside.with_name(aside.name + suffix))
    except OSError as error:
        raise StoreError(f"{path}: cannot be put aside: {error.strerror}", "read_only") from error
    return aside
