"""Keeps the memory of the process at what it uses."""

import asyncio
import ctypes
from typing import NoReturn

from mapperd.export.trajectory import TrajectoryWriter

__all__ = ["free_memory", "return_free_memory"]

PERIOD_S = 10.0


async def free_memory(trajectory: TrajectoryWriter) -> NoReturn:
    """Move the poses to the disk, and free memory to the system, until cancelled."""
    while True:
        await asyncio.sleep(PERIOD_S)
        await asyncio.to_thread(trajectory.flush)
        await asyncio.to_thread(return_free_memory)


def return_free_memory() -> None:
    """Return free memory to the system, which takes milliseconds.

    glibc keeps free pieces between used ones, for each thread apart: 170 MB after a backlog of
    100 MB, and more the longer threads allocate side by side.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # only glibc has it
    if trim is not None:
        trim(0)
