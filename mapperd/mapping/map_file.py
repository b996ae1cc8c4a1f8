"""Maps in files, without loss."""

from pathlib import Path

from mapperd import _core
from mapperd.errors import MapError
from mapperd.io import atomic_file

__all__ = ["load_map", "save_map"]


def save_map(core: _core.VoxelMap, path: Path) -> None:
    """Write a map into a file, whole or not at all. Equal maps give equal files.

    Raises:
        ExportError: the file cannot be written.
    """
    data = core.encode_map()
    with atomic_file(path) as file:
        file.write(data)


def load_map(core: _core.VoxelMap, path: Path) -> None:
    """Replace a map's content by that of a file; on any error it is as before.

    Raises:
        MapError: the file cannot be read (`unreadable`), is not a whole map file, or is one of
            another resolution, clamps or learning rate (`bad_map_file`).
    """
    magic = _core.MAP_FILE_MAGIC
    try:
        with path.open("rb") as file:
            begin = file.read(len(magic))
            # A device or a huge file of another kind is not read to its end.
            data = begin + file.read() if begin == magic else begin
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}", "unreadable") from error
    try:
        core.load_map(data)
    except ValueError as error:
        raise MapError(f"{path}: {error}", "bad_map_file") from error
