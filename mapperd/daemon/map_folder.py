"""The one folder that maps are saved into when somebody asks; nothing is written outside of it."""

import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mapperd.api import OperationError
from mapperd.config.live import ConfigStore
from mapperd.errors import ExportError, MapError, StoreError
from mapperd.export.cells import Heights
from mapperd.export.formats import FORMATS, crs_of, write_map
from mapperd.geometry.geodesy import Origin
from mapperd.io import make_folder
from mapperd.mapping.sonar_map import SonarMap

__all__ = ["MapFolder", "checked_name"]

MOST_BYTES = 200
"""Of a name: what is being written has a longer one, and file systems take 255."""

NAME = re.compile(r"\w[\w .+-]*\.\w+")


def checked_name(name: str) -> str:
    """A file's name that can only lie in the folder: letters, digits, and ` ._+-` inside.

    Raises:
        OperationError: it is none (`bad_name`), or its suffix no format (`bad_format`).
    """
    if not NAME.fullmatch(name) or len(name.encode(errors="replace")) > MOST_BYTES:
        raise OperationError(
            f"{name[:60]!a}: no name for a file; allowed: letters, digits, spaces and ._+- after "
            f"the first, no folder, at most {MOST_BYTES} bytes",
            "bad_name",
        )
    suffix = Path(name).suffix
    if suffix not in FORMATS:
        raise OperationError(
            f"{name}: no format has such a name; allowed: {' '.join(FORMATS)}", "bad_format"
        )
    return name


class MapFolder:
    """Saves maps into a folder, one at a time.

    Args:
        folder: is made when it is needed.
        settings: those of the exports follow them.
        clock: seconds.
    """

    FOLLOWS = ("export",)

    def __init__(
        self, folder: Path, settings: ConfigStore, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self.folder = folder
        self._settings = settings
        self._clock = clock
        self._busy = threading.Lock()
        settings.follow(self.FOLLOWS, lambda _: None)  # they are looked up at every save

    def save(
        self, name: str, whole_map: Callable[[], SonarMap], origin: Origin | None = None
    ) -> dict[str, Any]:
        """Write the map; takes seconds, in a thread of its own.

        Args:
            name: of the file; its suffix says the format.
            whole_map: gives the map when it is needed; may be slow, may raise what a store does.
            origin: where the map's zero lies on Earth; None where nobody knows.

        Returns:
            `path`, `bytes` of all files, `seconds`; `crs` of formats that can name a system of
            coordinates.

        Raises:
            OperationError: `bad_name`, `bad_format`, `cannot_write`, or `busy` with another.
        """
        checked_name(name)
        if not self._busy.acquire(blocking=False):
            raise OperationError("another map is being saved; try again", "busy")
        began_s = self._clock()
        try:
            make_folder(self.folder)
            files = write_map(whole_map(), self.folder / name, self._heights(), origin)
            size = sum(path.stat().st_size for path in files)
        except (ExportError, MapError, StoreError) as error:
            raise OperationError(str(error), "cannot_write") from error
        except OSError as error:
            raise OperationError(f"{self.folder}: {error.strerror}", "cannot_write") from error
        finally:
            self._busy.release()
        done = {"path": str(files[0]), "bytes": size, "seconds": self._clock() - began_s}
        crs = crs_of(files[0], origin)
        return done if crs is None else done | {"crs": crs}

    def _heights(self) -> Heights:
        export = self._settings.current.export
        return Heights(export.min_z, export.max_z)
