"""A process's time of day and the room on its disk, as a test wants them."""

import mmap
import struct
import subprocess
from pathlib import Path

__all__ = ["Shim"]

SOURCE = Path(__file__).with_name("shim.c")
FACTS = struct.Struct("=qq")


class Shim:
    """Builds the library that a process is to load, and sets what holds in it from now on.

    Args:
        folder: for the library and the file that controls it.

    Raises:
        subprocess.CalledProcessError: there is no C compiler, or it fails.
    """

    def __init__(self, folder: Path) -> None:
        self._library, self._control = folder / "chaos.so", folder / "chaos.control"
        command = ["cc", "-shared", "-fPIC", "-O1", "-o", str(self._library), str(SOURCE), "-ldl"]
        subprocess.run(command, check=True)  # noqa: S603 our own words
        self._control.write_bytes(FACTS.pack(0, 0))
        with self._control.open("r+b") as file:
            self._mapped = mmap.mmap(file.fileno(), FACTS.size)
        self._offset_ns, self._full = 0, False

    @property
    def environ(self) -> dict[str, str]:
        """What the process needs in its environment."""
        return {"LD_PRELOAD": str(self._library), "CHAOS_CONTROL": str(self._control)}

    def step_clock(self, offset_s: float) -> None:
        """Set the process's time of day off by so much."""
        self._offset_ns = round(offset_s * 1e9)
        self._write()

    def fill_disk(self, *, full: bool) -> None:
        """Let regular files take no bytes, or take them again."""
        self._full = full
        self._write()

    def close(self) -> None:
        """Let go of the file."""
        self._mapped.close()

    def _write(self) -> None:
        self._mapped[:] = FACTS.pack(self._offset_ns, int(self._full))
