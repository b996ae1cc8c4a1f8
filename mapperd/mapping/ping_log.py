"""Pings of a replay in a temporary file, so that the arc rule can integrate them again."""

import contextlib
import io
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapperd import _core
from mapperd.errors import ExportError, os_reason
from mapperd.geometry.motion import PingMotion

__all__ = ["ArcPing", "PingLog"]

COMPRESSION = 1
"""Higher levels take longer than the integration of the ping."""


class ArcPing(NamedTuple):
    """A ping as the arc rule integrates it.

    Attributes:
        intensity: (rows, beams) float32.
        level: (beams,) float32, intensity of a surface on the beam's axis.
        noise: (rows,) float32, median intensity of the noise.
        bearings_rad: (beams,) float64.
        range_resolution_m: thickness of a row.
        map_T_sonar: (4, 4) float64.
        motion: of the sonar during the ping; None at rest.
        min_range_m: nearer echoes do not count.
        carve_no_return: whether beams without an echo free the water.
        model: tables of the rule.
    """

    intensity: NDArray[np.float32]
    level: NDArray[np.float32]
    noise: NDArray[np.float32]
    bearings_rad: NDArray[np.float64]
    range_resolution_m: float
    map_T_sonar: NDArray[np.float64]  # noqa: N815 frames are named
    motion: PingMotion | None
    min_range_m: float
    carve_no_return: bool
    model: _core.ArcModel


class PingLog:
    """Pings and what they changed in the map; read back last first.

    Args:
        folder: of the temporary file, which has no name and vanishes with the log.

    Raises:
        ExportError: the file cannot be made, written or read; so do all methods.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with self._refusals():
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 it lives with the log
        self._entries: list[tuple[int, int, _core.ArcModel]] = []

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, ping: ArcPing, changes: _core.ArcChanges) -> None:
        """Add a ping that the map holds now."""
        arrays: dict[str, Any] = ping._asdict()
        del arrays["model"]
        if (motion := arrays.pop("motion")) is not None:
            speeds = (motion.valid_s, motion.speed_of_sound_mps)
            arrays["motion"] = np.concatenate([motion.linear_mps, motion.angular_radps, speeds])
        with np.errstate(invalid="ignore"):
            whole = ping.intensity.astype(np.uint8)
        if np.array_equal(whole, ping.intensity):  # compressed in a third of the time
            arrays["intensity"] = whole
        buffer = io.BytesIO()
        np.savez(buffer, counts=changes.counts, steps=changes.steps, **arrays)
        data = zlib.compress(buffer.getbuffer(), COMPRESSION)
        with self._refusals():
            start = self._file.tell()
            self._file.write(data)
        self._entries.append((start, len(data), ping.model))

    def close(self) -> None:
        """Remove the file."""
        self._file.close()

    def clear(self) -> None:
        """Forget all pings."""
        self._entries.clear()
        with self._refusals():
            self._file.seek(0)
            self._file.truncate()

    def from_last(self) -> Iterator[tuple[ArcPing, _core.ArcChanges]]:
        """Yield all pings and their changes, the last ping first."""
        for start, size, model in reversed(self._entries):
            with self._refusals():
                self._file.seek(start)
                data = zlib.decompress(self._file.read(size))
            with np.load(io.BytesIO(data)) as archive:
                arrays = dict(archive)
            arrays["intensity"] = arrays["intensity"].astype(np.float32)
            changes = _core.ArcChanges(arrays.pop("counts"), arrays.pop("steps"))
            held = arrays.pop("motion", None)
            motion = None
            if held is not None:
                motion = PingMotion(held[:3], held[3:6], float(held[6]), float(held[7]))
            for name in ("range_resolution_m", "min_range_m", "carve_no_return"):
                arrays[name] = arrays[name].item()
            yield ArcPing(**arrays, motion=motion, model=model), changes

    @contextlib.contextmanager
    def _refusals(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            text = f"{self._folder}: pings cannot be kept for refining: {os_reason(error)}"
            raise ExportError(text) from error
